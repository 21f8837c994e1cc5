"""Regions in the other cameras of an instant: where the same face or plate lies, by the geometry of the rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.privacy.regions import Region, covered_share

_SIZE_M: Final = {"face": 0.22, "plate": 0.46}
"""Height of a face and width of a plate (440 mm in China, 520 mm in Europe, 305 mm in North America)."""
_DEPTHS: Final = (0.6, 1.0, 1.6)
"""Shares of the distance that follows from the size: a face of a child, a plate that is seen at an angle."""
_COVERED: Final = 0.5
_LARGEST: Final = 0.15
"""Share of the raster above which a region is too uncertain to be of use."""


@dataclass(frozen=True, eq=False)
class PosedCamera:
    """One camera at one instant.

    Attributes:
        camera: intrinsics.
        world_SE3_camera: one pose.
    """

    camera: Camera
    world_SE3_camera: Poses


def project_to_cameras(
    regions: Mapping[str, Sequence[Region]], views: Mapping[str, PosedCamera]
) -> dict[str, list[Region]]:
    """Find the regions of other cameras that show an object which one camera's detector found.

    The distance of a face or plate follows from its usual size. Because that is uncertain, the projections for 0.6, 1
    and 1.6 times the distance are joined; cameras whose baseline makes the result larger than 15 % of the raster add
    nothing. Cameras without common field of view add nothing.

    Args:
        regions: regions by camera.
        views: the cameras of the instant; a camera without a pose or calibration is absent.

    Returns:
        The added regions by camera, with origin `camera`.
    """
    added: dict[str, list[Region]] = {name: [] for name in views}
    for source, own in regions.items():
        if source not in views:
            continue
        for region in own:
            points = _points_m(region, views[source])
            for target, view in views.items():
                if target == source or points is None:
                    continue
                box = _bounds(points, view)
                if box is None:
                    continue
                others = [other.box_px for other in regions.get(target, ()) if other.kind == region.kind]
                if covered_share(box.tolist(), others) < _COVERED:
                    added[target].append(region.moved_to(box.tolist(), "camera"))
    return added


def _points_m(region: Region, view: PosedCamera) -> Float64 | None:
    """Corners (12, 3) in the world of a region at three distances; None: its rays are not defined."""
    left, top, right, bottom = region.box_px
    rays = view.camera.unproject([(left, top), (right, top), (right, bottom), (left, bottom)])
    if not rays.valid.all():
        return None
    directions = rays.direction / np.linalg.norm(rays.direction, axis=-1, keepdims=True)
    side = (0, 1) if region.kind == "plate" else (0, 3)
    angle = np.arccos(np.clip(directions[side[0]] @ directions[side[1]], -1.0, 1.0))
    distance = _SIZE_M[region.kind] / max(2.0 * np.tan(0.5 * angle), 1e-6)
    points = np.concatenate([share * distance * directions for share in _DEPTHS])
    return np.asarray(view.world_SE3_camera.transform(points)[0], np.float64)


def _bounds(points_m: Float64, view: PosedCamera) -> Float64 | None:
    """Bounds (4,) of points in a camera's raster; None: it does not see them, or their place is too uncertain."""
    projected = view.camera.project(view.world_SE3_camera.inverse().transform(points_m)[0])
    if not projected.defined.all() or not projected.valid.any():
        return None
    size = np.array([view.camera.width_px, view.camera.height_px], np.float64)
    low, high = (np.clip(edge, 0.0, size) for edge in (projected.uv_px.min(axis=0), projected.uv_px.max(axis=0)))
    extent = high - low
    if (extent < 1.0).any() or extent.prod() > _LARGEST * size.prod():
        return None
    return np.concatenate([low, high])
