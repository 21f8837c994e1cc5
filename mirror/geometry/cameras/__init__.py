"""Camera models: perspective ones with distortion, and fisheyes."""

from __future__ import annotations

from mirror.geometry.cameras.camera import COEFFICIENTS, Camera, Projection, Rays, camera_from_row

__all__ = ["COEFFICIENTS", "Camera", "Projection", "Rays", "camera_from_row"]
