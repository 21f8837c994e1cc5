"""A floor that shows no place: each view shows the mean of its camera's training images in the scene.

A score that this floor raises above ``nearest_frame`` rewards a typical street, not this one: sky above, road below, a
facade at either side. `psnr_invariant` did so by 0.2 to 0.5 dB (docs/threat-model/figures.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import cv2
import numpy as np

from mirror.arrays import Float64, UInt8
from mirror.dataset.dataset import Dataset
from mirror.dataset.image import Image
from mirror.evaluation.submission.manifest import Appearance, SubmittedMethod
from mirror.evaluation.submission.writing import Render
from mirror.methods.training_images import list_training_images
from mirror.protocols.document import Pixels
from mirror.protocols.truth.raster import cached_raster
from mirror.protocols.views import Plan, RenderView

MAX_IMAGES: Final = 40
"""Largest number of images opened for a camera, evenly spaced; with more the mean hardly changes."""

METHOD: Final = SubmittedMethod(
    name="camera_mean",
    version="1",
    licence="Apache-2.0",
    trained_on="nothing: images of the split's training traversals are averaged",
)
APPEARANCE: Final = Appearance(
    policy="mean", description=f"of at most {MAX_IMAGES} training images of the camera in the scene"
)


def render(dataset: Dataset, plan: Plan) -> Iterator[Render]:
    """Render one image for each scene, camera and size; see `mirror.evaluation.submission.writing.Renderer`."""
    images = list_training_images(dataset, plan)
    views: dict[tuple[str, str], dict[tuple[int, int], list[RenderView]]] = {}
    for view in plan.views:
        sizes = views.setdefault((view.scene_id, view.camera), {})
        sizes.setdefault((view.width_px, view.height_px), []).append(view)
    for key, sizes in views.items():
        for size, mean in mean_images(images[key].images, list(sizes), plan.protocol.pixels).items():
            yield sizes[size], mean


def mean_images(
    images: Sequence[Image], sizes: Sequence[tuple[int, int]], pixels: Pixels
) -> dict[tuple[int, int], UInt8]:
    """Average at most `MAX_IMAGES` images of a camera, in the raster of a protocol.

    Args:
        images: (N,) N >= 1, of one camera.
        sizes: widths and heights of the means.
        pixels: the protocol's raster.

    Returns:
        The mean image (height, width, 3) of each size.

    Raises:
        DatasetError: an image is missing or broken.
    """
    places = np.unique(np.linspace(0, len(images) - 1, min(len(images), MAX_IMAGES)).round().astype(int)).tolist()
    sums: dict[tuple[int, int], Float64] = {size: np.zeros((size[1], size[0], 3)) for size in sizes}
    for place in places:
        image = cached_raster(images[place].camera_model, pixels).to_final(images[place].decode())
        for size, total in sums.items():
            # Rigs differ in the sizes of a camera's images.
            has_size = image.shape[1::-1] == size
            total += image if has_size else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return {size: np.rint(total / len(places)).astype(np.uint8) for size, total in sums.items()}
