"""Resampling of images and masks from the recorded raster to an undistorted or resized raster, or both."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Final

import cv2
import numpy as np

from mirror.arrays import AnyArray, Bool, Float32, UInt8
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera, undistorted

Resize = tuple[int, int] | float
"""(height, width) in pixels, or a factor."""

# Number of rasters that are kept; the maps of a lens take 8 bytes a pixel.
_CACHED_RASTERS: Final = 32


@dataclass(frozen=True)
class ImageRaster:
    """A resampler of images and masks of one camera, which undistorts them first and then resizes them.

    Attributes:
        recorded: the calibrated camera.
        full: the undistorted camera with the recorded size; equal to ``recorded`` if nothing is undistorted.
        final: ``full``, resized.
    """

    recorded: Camera
    full: Camera
    final: Camera

    @cached_property
    def maps(self) -> tuple[Float32, Float32] | None:
        """Position of each pixel of ``full`` in the recorded image, for ``cv2.remap``; None if positions are equal."""
        return None if self.full == self.recorded else self.recorded.undistort_maps(self.full)

    @cached_property
    def outside(self) -> Bool:
        """(H, W) of ``full``: True outside the lens's range, or where interpolation would cross the image's border."""
        if self.maps is None:
            return np.zeros((self.full.height_px, self.full.width_px), np.bool_)
        u, v = self.maps
        inside = (u >= 0.0) & (u <= self.recorded.width_px - 1) & (v >= 0.0) & (v <= self.recorded.height_px - 1)
        return np.asarray(~inside)

    @cached_property
    def covered(self) -> Bool:
        """(H, W) of ``final``: True where a pixel is computed only from recorded pixels."""
        return np.asarray(self._resized(self.outside.astype(np.float32)) == 0.0)

    def image(self, recorded: UInt8) -> UInt8:
        """Resample a recorded image (H, W, 3) to the final raster; black outside the lens's range.

        Undistortion and enlargement are bilinear. A pixel of a smaller raster is the mean of the area that it covers.
        """
        if self.maps is not None:
            recorded = np.asarray(
                cv2.remap(recorded, *self.maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.uint8
            )
        return np.asarray(self._resized(recorded), np.uint8)

    def mask(self, recorded: UInt8) -> UInt8:
        """Resample a recorded mask (H, W) to the final raster by nearest neighbour; 0 outside the lens's range.

        Raises:
            UsageError: the size of the mask differs from that of the recorded image.
        """
        size = (self.recorded.height_px, self.recorded.width_px)
        if recorded.shape != size:
            raise UsageError(f"a mask of shape {recorded.shape}", expected=f"that of its image, {size}")
        if self.maps is not None:
            u, v = self._mask_maps
            return np.asarray(cv2.remap(recorded, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT), np.uint8)
        if not self._is_resized:
            return recorded
        return np.asarray(cv2.resize(recorded, self._size, interpolation=cv2.INTER_NEAREST_EXACT), np.uint8)

    @cached_property
    def _mask_maps(self) -> tuple[Float32, Float32]:
        """Maps for undistortion and resizing in one step: rounding twice would shift a mask by up to one pixel."""
        return self.recorded.undistort_maps(self.final)

    @property
    def _size(self) -> tuple[int, int]:
        return (self.final.width_px, self.final.height_px)

    @property
    def _is_resized(self) -> bool:
        return self._size != (self.full.width_px, self.full.height_px)

    def _resized(self, pixels: AnyArray) -> AnyArray:
        if not self._is_resized:
            return pixels
        smaller = self.final.width_px <= self.full.width_px and self.final.height_px <= self.full.height_px
        return np.asarray(cv2.resize(pixels, self._size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR))


@lru_cache(_CACHED_RASTERS)
def image_raster(camera: Camera, undistort: bool, resize: Resize | None) -> ImageRaster:
    """Return the raster of a camera; the rasters of the last 32 cameras are cached, with their maps.

    Args:
        camera: the calibrated camera.
        undistort: map to the pinhole of `mirror.geometry.undistorted`; a pinhole is not changed.
        resize: argument of `resized_shape`.

    Raises:
        UsageError: no pinhole shows any part of the lens's range.
    """
    full = undistorted(camera) if undistort and camera.model != "pinhole" else camera
    height, width = resized_shape((camera.height_px, camera.width_px), resize)
    return ImageRaster(camera, full, full.resized(width, height))


def resized_shape(shape: tuple[int, int], resize: Resize | None) -> tuple[int, int]:
    """Return the height and width of a resized image.

    Args:
        shape: (height, width) before.
        resize: (height, width) after, which need not keep the proportions; or a factor for both, rounded to whole
            pixels; None: no change.
    """
    if resize is None:
        return shape
    if isinstance(resize, tuple):
        return resize
    return max(round(shape[0] * resize), 1), max(round(shape[1] * resize), 1)


def validate_resize(resize: object) -> Resize | None:
    """Convert a caller's option ``resize`` to an argument of `resized_shape`.

    Raises:
        UsageError: the value is neither (height, width) nor a factor.
    """
    if resize is None:
        return None
    if isinstance(resize, list | tuple):
        if len(resize) == 2 and all(isinstance(side, int | np.integer) and 0 < side < 1 << 15 for side in resize):
            return int(resize[0]), int(resize[1])
    elif isinstance(resize, float) and 0.0 < resize <= 16.0:
        return resize
    raise UsageError(
        f"resize={resize!r}", expected="(height, width) in pixels, or a factor as a float, such as 0.5: at most 16.0"
    )
