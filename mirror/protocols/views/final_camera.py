"""The camera of the raster in which renders are compared: raw or undistorted, and not wider than the protocol says."""

from __future__ import annotations

from mirror.geometry.cameras import Camera, undistorted
from mirror.protocols.document import Pixels

_BORDER_POINTS = 256


def full_camera(camera: Camera, pixels: Pixels) -> Camera:
    """The camera of the protocol's space, in the recorded raster.

    Raises:
        UsageError: the lens sees nothing within the protocol's angle.
    """
    if pixels.space == "raw" or (camera.model == "pinhole" and not camera.distortion):
        return camera
    return undistorted(camera, pixels.widest_deg)


def final_camera(camera: Camera, pixels: Pixels) -> Camera:
    """The camera of renders: that of `full_camera`, scaled down to the protocol's width if it is wider."""
    full = full_camera(camera, pixels)
    if full.width_px <= pixels.max_width_px:
        return full
    height = max(round(full.height_px * pixels.max_width_px / full.width_px), 1)
    return full.resized(pixels.max_width_px, height)
