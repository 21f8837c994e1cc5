"""Camera models: perspective ones with distortion, and fisheyes."""

from __future__ import annotations

from mirror.geometry.cameras.camera import (
    COEFFICIENTS,
    Camera,
    Projection,
    Rays,
    camera_from_attributes,
    camera_from_row,
)
from mirror.geometry.cameras.pinhole import WIDEST_DEG, undistorted

__all__ = [
    "COEFFICIENTS",
    "WIDEST_DEG",
    "Camera",
    "Projection",
    "Rays",
    "camera_from_attributes",
    "camera_from_row",
    "undistorted",
]
