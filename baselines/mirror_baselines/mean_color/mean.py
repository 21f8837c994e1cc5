"""The mean colour of each camera's training images, and images of that colour."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import cv2
import numpy as np

from mirror.arrays import Float64, UInt8
from mirror.dataset.dataset import Dataset
from mirror.dataset.image import Image
from mirror.evaluation.submission.writing import Render
from mirror.methods.training_images import list_training_images
from mirror.protocols.views import Plan, RenderView

MAX_IMAGES: Final = 200
"""Largest number of images opened for a camera, evenly spaced; with more the mean hardly changes."""


def mean_colour(images: Sequence[Image]) -> Float64:
    """Return the mean colour (3,), RGB, 0 to 255, of at most `MAX_IMAGES` images.

    It is the mean of 8-bit sRGB values, not of light, because PSNR is computed from the squared error of these values.

    Args:
        images: (N,) N >= 1.

    Raises:
        DatasetError: an image is missing or broken.
    """
    places = np.linspace(0, len(images) - 1, min(len(images), MAX_IMAGES)).round().astype(int)
    colours = [cv2.mean(images[place].decode())[:3] for place in places.tolist()]
    return np.asarray(np.mean(colours, axis=0))


def render(dataset: Dataset, plan: Plan) -> Iterator[Render]:
    """Render one image for each scene, camera and size; see `mirror.evaluation.submission.writing.Renderer`."""
    colours = {key: mean_colour(training.images) for key, training in list_training_images(dataset, plan).items()}
    views_by_size: dict[tuple[str, str, int, int], list[RenderView]] = {}
    for view in plan.views:
        views_by_size.setdefault((view.scene_id, view.camera, view.width_px, view.height_px), []).append(view)
    for (scene, camera, width, height), views in views_by_size.items():
        image: UInt8 = np.empty((height, width, 3), np.uint8)
        image[:] = colours[scene, camera].round().astype(np.uint8)
        yield views, image
