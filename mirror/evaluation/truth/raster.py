"""From recorded pictures and masks to the raster in which renders are compared."""

from __future__ import annotations

from functools import cached_property, lru_cache

import cv2
import numpy as np

from mirror.arrays import Bool, Float32, UInt8
from mirror.evaluation.protocol import Pixels
from mirror.evaluation.views.final_camera import final_camera, full_camera
from mirror.geometry.cameras import Camera

_HELD = 64


class Raster:
    """Takes pictures of one lens into the final raster: first undistorted, then scaled down.

    Args:
        camera: as recorded.
        pixels: the protocol's.
    """

    def __init__(self, camera: Camera, pixels: Pixels) -> None:
        self._camera, self._pixels = camera, pixels
        self._full, self.final = full_camera(camera, pixels), final_camera(camera, pixels)
        self._size = (self.final.width_px, self.final.height_px)
        self._smaller = self._size != (self._full.width_px, self._full.height_px)

    @cached_property
    def _maps(self) -> tuple[Float32, Float32] | None:
        return None if self._full == self._camera else self._camera.undistort_maps(self._full)

    def picture(self, recorded: UInt8) -> UInt8:
        """A recorded picture (H, W, 3) in the final raster; black where the lens sees nothing."""
        if self._maps is not None:
            recorded = np.asarray(
                cv2.remap(recorded, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.uint8
            )
        if self._smaller:
            recorded = np.asarray(cv2.resize(recorded, self._size, interpolation=cv2.INTER_AREA), np.uint8)
        return recorded

    def excluded(self, recorded: Bool) -> Bool:
        """A mask (H, W) of recorded pixels that are not scored, in the final raster.

        An undistorted pixel is excluded if any of the recorded ones that it is interpolated from is.
        """
        mask = recorded.astype(np.float32)
        if self._maps is not None:
            mask = np.asarray(cv2.remap(mask, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
        return self._scaled(mask > 0.0)

    @cached_property
    def unseen(self) -> Bool:
        """(H, W) True where the lens sees nothing, or a pixel would be interpolated across the recorded border."""
        if self._maps is None:
            return np.zeros(self._size[::-1], np.bool_)
        u, v = self._maps
        inside = (u >= 0.0) & (u <= self._camera.width_px - 1) & (v >= 0.0) & (v <= self._camera.height_px - 1)
        return self._scaled(~inside)

    def _scaled(self, excluded: Bool) -> Bool:
        if not self._smaller:
            return excluded
        if self._pixels.mask_resize == "nearest":
            return np.asarray(
                cv2.resize(excluded.astype(np.uint8), self._size, interpolation=cv2.INTER_NEAREST_EXACT) > 0
            )
        return np.asarray(cv2.resize(excluded.astype(np.float32), self._size, interpolation=cv2.INTER_AREA) > 0.0)


@lru_cache(_HELD)
def raster_of(camera: Camera, pixels: Pixels) -> Raster:
    """The raster of a lens; a few are held, with their maps."""
    return Raster(camera, pixels)
