"""The geometric fallback for number plates: the strips at the front and rear of vehicles' 3D boxes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.privacy.regions import Region, region_at

VEHICLES: Final = frozenset(
    ("car", "van", "truck", "bus", "trailer", "vehicle", "motorcycle", "construction_vehicle", "pickup", "taxi")
)
"""Categories of boxes that carry number plates; other categories are recognised by their words."""
SOURCE: Final = "vehicle_boxes"
_HALF_WIDTH_M: Final = 0.28
_LOW_M, _HIGH_M = 0.42, 0.95
"""A strip is enlarged like every region, by 30 %: to 0.73 m times 0.69 m."""
_DEPTHS_M: Final = (0.0, 0.30)
"""Distance of the plate from the end of the box: bumpers are curved, tailgates are inclined."""
_LEAST_COSINE: Final = 0.17
"""Plates that are seen at more than 80 degrees are not readable."""
_PLATE_M: Final = 0.52
_LEAST_PX: Final = 20.0
"""Width of a plate as it appears: below it, a character has less than three pixels."""
_SURE: Final = 0.5


def plate_strips(
    camera: Camera,
    camera_SE3_box: Poses,
    size_m: Float64,
    category: Sequence[str],
    detected: Sequence[Region],
) -> list[Region]:
    """Find where vehicles carry plates that no detector found.

    Args:
        camera: the camera.
        camera_SE3_box: N poses of boxes in the camera frame; their x axis points ahead, their z axis up.
        size_m: (N, 3) length, width and height.
        category: N categories; only `VEHICLES` have plates.
        detected: regions of the image. A strip with a detected plate of a score of at least 0.5 in it is left out.

    Returns:
        Regions of kind `plate` and origin `vehicle`.
    """
    if not len(category):
        return []
    strips = []
    boxes = camera_SE3_box
    for row in np.flatnonzero([is_vehicle(name) for name in category]):
        for end in (1.0, -1.0):
            box_px = _strip_px(camera, boxes[row : row + 1], size_m[row], end)
            if box_px is None:
                continue
            if any(one.kind == "plate" and one.score >= _SURE and _holds(box_px, one.centre_px) for one in detected):
                continue
            region = region_at(box_px.tolist(), "plate", score=0.0, source=SOURCE)
            strips.append(region.moved_to(region.box_px, "vehicle"))
    return strips


def is_vehicle(category: str) -> bool:
    """Whether objects of a category carry number plates."""
    words = set(category.lower().replace(".", "_").replace(" ", "_").replace("-", "_").split("_"))
    return category.lower() in VEHICLES or bool(words & VEHICLES)


def _strip_px(camera: Camera, camera_SE3_box: Poses, size_m: Float64, end: float) -> Float64 | None:
    """Bounds (4,) of the strip at one end of a vehicle; None: it faces away, is not seen, or is too small to read."""
    length, width, height = (float(value) for value in size_m)
    half = min(_HALF_WIDTH_M, 0.5 * width)
    low, high = (min(level, height) - 0.5 * height for level in (_LOW_M, _HIGH_M))
    corners = np.array(
        [
            (end * (0.5 * length - depth), side * half, level)
            for depth in _DEPTHS_M
            for side in (-1.0, 1.0)
            for level in (low, high)
        ]
    )
    points = camera_SE3_box.transform(corners)[0]
    middle = points.mean(axis=0)
    outward = camera_SE3_box.transform(np.array([[end, 0.0, 0.0], [0.0, 0.0, 0.0]]))[0]
    cosine = float((outward[0] - outward[1]) @ -middle / max(np.linalg.norm(middle), 1e-9))
    if cosine < _LEAST_COSINE:
        return None
    projected = camera.project(points)
    if not projected.defined.all() or not projected.valid.any():
        return None
    size = np.array([camera.width_px, camera.height_px], np.float64)
    bounds = np.concatenate([projected.uv_px.min(axis=0), projected.uv_px.max(axis=0)])
    clipped = np.clip(bounds, 0.0, np.tile(size, 2))
    if (clipped[2:] - clipped[:2] < 1.0).any():
        return None
    width_px = cosine * _PLATE_M * camera.fx_px / max(float(np.linalg.norm(middle)), 1e-9)
    # An f-theta lens has no focal length in pixels.
    return clipped if camera.fx_px <= 1.0 or width_px >= _LEAST_PX else None


def _holds(box_px: Float64, point: tuple[float, float]) -> bool:
    return bool(box_px[0] <= point[0] <= box_px[2] and box_px[1] <= point[1] <= box_px[3])
