"""The final camera, in which renders are compared: raw or undistorted, and at most as wide as the protocol allows."""

from __future__ import annotations

from mirror.geometry.cameras import Camera, undistorted
from mirror.protocols.document import Pixels

_BORDER_POINTS = 256


def full_camera(camera: Camera, pixels: Pixels) -> Camera:
    """Compute the camera at the recorded size: the recorded camera, or its undistorted pinhole.

    Raises:
        UsageError: the lens sees nothing within the protocol's largest angle.
    """
    if pixels.space == "raw" or (camera.model == "pinhole" and not camera.distortion):
        return camera
    return undistorted(camera, pixels.widest_deg)


def final_camera(camera: Camera, pixels: Pixels) -> Camera:
    """Compute the camera of renders: `full_camera`, scaled down to the protocol's largest width if it is wider."""
    full = full_camera(camera, pixels)
    if full.width_px <= pixels.max_width_px:
        return full
    height = max(round(full.height_px * pixels.max_width_px / full.width_px), 1)
    return full.resized(pixels.max_width_px, height)
