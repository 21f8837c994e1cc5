"""Finds the nearest pose and shows its image; only the needed images are opened, each once."""

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
"""Distance that a rotation of one radian counts as. A point at this distance moves in the image as much when the camera
moves by this distance as when it rotates by one radian."""

PAIRS_AT_ONCE: Final = 4_000_000


def find_nearest(queries: Poses, candidates: Poses) -> Int64:
    """Find the nearest pose for each query, by position and heading.

    The distance of two cameras is the root of the sum of the squared distance of their centres and the squared chord
    between their viewing directions, where a radian counts as `METRES_PER_RADIAN`. Among equally near poses the first
    is returned.

    Args:
        queries: (N) ``world_SE3_camera``.
        candidates: (M) ``world_SE3_camera``, M >= 1.

    Returns:
        (N,) rows of ``candidates``.
    """
    # World coordinates may be large: squares of centred ones lose no precision.
    origin = candidates.translation.mean(axis=0)
    query_features, candidate_features = _pose_features(queries, origin), _pose_features(candidates, origin)
    step = max(PAIRS_AT_ONCE // len(candidate_features), 1)
    rows = [
        _closest_rows(query_features[start : start + step], candidate_features)
        for start in range(0, len(query_features), step)
    ]
    return np.concatenate(rows) if rows else np.empty(0, np.int64)


def render(dataset: Dataset, plan: Plan) -> Iterator[Render]:
    """Render each view, grouped by shared image; see `mirror.evaluation.submission.writing.Renderer`."""
    images = list_training_images(dataset, plan)
    views: dict[tuple[str, str], list[RenderView]] = {}
    for view in plan.views:
        views.setdefault((view.scene_id, view.camera), []).append(view)
    for key, group in views.items():
        candidates = images[key]
        rows = find_nearest(_poses(group), candidates.world_SE3_camera)
        for row in np.unique(rows).tolist():
            same_image = [group[place] for place in np.flatnonzero(rows == row).tolist()]
            yield from _to_renders(candidates.images[row], same_image, plan.protocol.pixels)


def _pose_features(poses: Poses, origin: Float64) -> Float64:
    """(N, 6): position and scaled viewing direction of cameras, in metres."""
    forward = poses.matrix()[:, :3, 2]
    return np.concatenate((poses.translation - origin, METRES_PER_RADIAN * forward), axis=1)


def _closest_rows(query_features: Float64, candidate_features: Float64) -> Int64:
    squares = ((query_features[:, None, :] - candidate_features[None, :, :]) ** 2).sum(axis=2)
    return np.asarray(squares.argmin(axis=1), np.int64)


def _poses(views: list[RenderView]) -> Poses:
    poses = [view.world_SE3_camera for view in views]
    return Poses(np.concatenate([one.rotation for one in poses]), np.concatenate([one.translation for one in poses]))


def _to_renders(image: Image, views: list[RenderView], pixels: Pixels) -> Iterator[Render]:
    """One recorded image in the raster of its camera, resized for views of another size."""
    image_pixels = cached_raster(image.camera_model, pixels).to_final(image.decode())
    sizes: dict[tuple[int, int], list[RenderView]] = {}
    for view in views:
        sizes.setdefault((view.width_px, view.height_px), []).append(view)
    for size, group in sizes.items():
        has_size = image_pixels.shape[1::-1] == size
        yield (
            group,
            image_pixels
            if has_size
            else np.asarray(cv2.resize(image_pixels, size, interpolation=cv2.INTER_AREA), np.uint8),
        )
