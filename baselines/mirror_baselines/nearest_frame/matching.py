"""Finds the nearest pose and shows its image; only chosen images are opened, and each of them once."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np

from mirror.arrays import Float64, Int64
from mirror.dataset.dataset import Dataset
from mirror.dataset.image import Image
from mirror.evaluation.submission.writing import Render
from mirror.geometry.poses import Poses
from mirror.methods.training_images import list_training_images
from mirror.protocols.document import Pixels
from mirror.protocols.truth.raster import cached_raster
from mirror.protocols.views import Plan, RenderView

METRES_PER_RADIAN: Final = 10.0
"""What a turn counts as: what is this far away moves by as much in the image when the camera moves by it."""

PAIRS_AT_ONCE: Final = 4_000_000


def find_nearest(wanted: Poses, there: Poses) -> Int64:
    """The pose nearest to each of others, by position and heading.

    The distance of two cameras is the root of the squared distance of their centres and the squared chord between
    their viewing directions, a radian counting as `METRES_PER_RADIAN`. Of equally near ones the first is taken.

    Args:
        wanted: (N) ``world_SE3_camera``.
        there: (M) ``world_SE3_camera``, M >= 1.

    Returns:
        (N,) rows of ``there``.
    """
    # World coordinates may be large, and their squares cancel.
    origin = there.translation.mean(axis=0)
    ours, theirs = _features(wanted, origin), _features(there, origin)
    step = max(PAIRS_AT_ONCE // len(theirs), 1)
    rows = [_closest(ours[start : start + step], theirs) for start in range(0, len(ours), step)]
    return np.concatenate(rows) if rows else np.empty(0, np.int64)


def render(dataset: Dataset, plan: Plan) -> Iterator[Render]:
    """The image of each view, those that share one together; see `mirror.evaluation.submission.writing.Renderer`."""
    images = list_training_images(dataset, plan)
    views: dict[tuple[str, str], list[RenderView]] = {}
    for view in plan.views:
        views.setdefault((view.scene_id, view.camera), []).append(view)
    for key, own in views.items():
        there = images[key]
        rows = find_nearest(_poses(own), there.world_SE3_camera)
        for row in np.unique(rows).tolist():
            sharing = [own[place] for place in np.flatnonzero(rows == row).tolist()]
            yield from _shown(there.images[row], sharing, plan.protocol.pixels)


def _features(poses: Poses, origin: Float64) -> Float64:
    """(N, 6): where a camera is and where it looks, in metres."""
    forward = poses.matrix()[:, :3, 2]
    return np.concatenate((poses.translation - origin, METRES_PER_RADIAN * forward), axis=1)


def _closest(ours: Float64, theirs: Float64) -> Int64:
    squares = ((ours[:, None, :] - theirs[None, :, :]) ** 2).sum(axis=2)
    return np.asarray(squares.argmin(axis=1), np.int64)


def _poses(views: list[RenderView]) -> Poses:
    numbers = np.array([view.world_SE3_camera for view in views])
    return Poses(numbers[:, :4], numbers[:, 4:])


def _shown(image: Image, views: list[RenderView], pixels: Pixels) -> Iterator[Render]:
    """One recorded image in the raster of its own camera, scaled where a view's has another size."""
    picture = cached_raster(image.camera_model, pixels).to_final(image.decode())
    sizes: dict[tuple[int, int], list[RenderView]] = {}
    for view in views:
        sizes.setdefault((view.width_px, view.height_px), []).append(view)
    for size, own in sizes.items():
        fits = picture.shape[1::-1] == size
        yield own, picture if fits else np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
