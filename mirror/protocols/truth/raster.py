"""Resampling of recorded images and masks to the final raster, in which renders are compared."""

from __future__ import annotations

from functools import cached_property, lru_cache

import cv2
import numpy as np

from mirror.arrays import Bool, UInt8
from mirror.dataset.raster import ImageRaster
from mirror.geometry.cameras import Camera
from mirror.protocols.document import Pixels
from mirror.protocols.views.final_camera import final_camera, full_camera

_CACHED_RASTERS = 64


class Raster:
    """A resampler of one camera model's images to the final raster: undistorts them, then scales them down.

    Args:
        camera: recorded camera model.
        pixels: raster settings of the protocol.
    """

    def __init__(self, camera: Camera, pixels: Pixels) -> None:
        self._pixels = pixels
        self.final = final_camera(camera, pixels)
        self._raster = ImageRaster(camera, full_camera(camera, pixels), self.final)
        self._size = (self.final.width_px, self.final.height_px)
        self._smaller = self._size != (self._raster.full.width_px, self._raster.full.height_px)

    def to_final(self, recorded: UInt8) -> UInt8:
        """Resample a recorded image (H, W, 3) to the final raster; pixels outside the lens are black."""
        return self._raster.image(recorded)

    def exclude(self, recorded: Bool) -> Bool:
        """Resample a mask (H, W) of unscored recorded pixels to the final raster.

        An undistorted pixel is excluded if any recorded pixel that it is interpolated from is excluded.
        """
        mask = recorded.astype(np.float32)
        if self._raster.maps is not None:
            mask = np.asarray(cv2.remap(mask, *self._raster.maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
        return self._scaled(mask > 0.0)

    @cached_property
    def outside_lens(self) -> Bool:
        """(H, W) mask: True outside the lens's field of view, or if a pixel is interpolated across the image border."""
        return self._scaled(self._raster.outside)

    def _scaled(self, excluded: Bool) -> Bool:
        if not self._smaller:
            return excluded
        if self._pixels.mask_resize == "nearest":
            return np.asarray(
                cv2.resize(excluded.astype(np.uint8), self._size, interpolation=cv2.INTER_NEAREST_EXACT) > 0
            )
        return np.asarray(cv2.resize(excluded.astype(np.float32), self._size, interpolation=cv2.INTER_AREA) > 0.0)


@lru_cache(_CACHED_RASTERS)
def cached_raster(camera: Camera, pixels: Pixels) -> Raster:
    """Return the raster of a camera model; the last 64 rasters stay in memory with their remapping tables."""
    return Raster(camera, pixels)
