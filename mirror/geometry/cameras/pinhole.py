"""The pinhole camera of an undistorted image."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.geometry.cameras.camera import Camera

WIDEST_DEG: Final = 70.0

_BORDER_POINTS: Final = 256


def undistorted(camera: Camera, widest_deg: float = WIDEST_DEG) -> Camera:
    """Return a pinhole camera of the same raster that covers a lens's view within an angle of its axis.

    OpenCV's ``getOptimalNewCameraMatrix`` with alpha = 1 does so for lenses that image a plane; here the border is
    followed by rays, so that fisheyes have one as well. The camera frame stays the same: poses need no change.

    Args:
        camera: as calibrated.
        widest_deg: angle from the axis, below 90 degrees.

    Raises:
        UsageError: the lens sees nothing within the angle.
    """
    reach = np.tan(np.radians(widest_deg))
    points = _seen_rim(camera, reach)
    if not len(points):
        raise UsageError(
            f"camera model {camera.model} sees nothing within {widest_deg:g} degrees of its axis",
            expected="a calibrated lens",
            remedy="correct the calibration",
        )
    low, high = points.min(axis=0), points.max(axis=0)
    focal = np.array([camera.width_px, camera.height_px]) / (high - low)
    centre = -focal * low
    return Camera("pinhole", camera.width_px, camera.height_px, *focal.tolist(), *centre.tolist())


def _seen_rim(camera: Camera, reach: float) -> Float64:
    """Points (N, 2) of the plane z = 1 that bound what is seen: the raster's border, cut at a radius."""
    share = np.linspace(0.0, 1.0, _BORDER_POINTS)
    zero, one = np.zeros_like(share), np.ones_like(share)
    border = np.concatenate(
        [np.stack(side, axis=1) for side in ((share, zero), (share, one), (zero, share), (one, share))]
    )
    rays = camera.unproject(border * (camera.width_px, camera.height_px))
    plane = _on_plane(rays.direction[rays.valid], reach)
    around = np.linspace(0.0, 2.0 * np.pi, 4 * _BORDER_POINTS, endpoint=False)
    rim = reach * np.stack((np.cos(around), np.sin(around)), axis=1)
    seen = camera.project(np.column_stack((rim, np.ones(len(rim))))).valid
    return np.concatenate((plane, rim[seen]))


def _on_plane(direction: Float64, reach: float) -> Float64:
    """Find where rays (N, 3) meet the plane z = 1, those within a radius."""
    front = direction[direction[:, 2] > 0.0]
    points = front[:, :2] / front[:, 2:]
    return np.asarray(points[np.hypot(*points.T) <= reach])
