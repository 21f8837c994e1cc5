"""From the recorded raster of a camera to another one at the same place: undistorted, resized, or both."""

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

# Maps of a lens take 8 bytes a pixel.
_HELD: Final = 32


@dataclass(frozen=True)
class ImageRaster:
    """Takes images and masks of one camera into another raster: first undistorted, then resized.

    Attributes:
        recorded: the camera as calibrated.
        full: the camera of the undistorted raster, of the recorded size; ``recorded`` itself: nothing is undistorted.
        final: ``full``, resized.
    """

    recorded: Camera
    full: Camera
    final: Camera

    @cached_property
    def maps(self) -> tuple[Float32, Float32] | None:
        """Where each pixel of ``full`` lies in the recorded image, for ``cv2.remap``; None: in the same place."""
        return None if self.full == self.recorded else self.recorded.undistort_maps(self.full)

    @cached_property
    def outside(self) -> Bool:
        """(H, W) of ``full``: True where the lens sees nothing, or a pixel would be interpolated across the border."""
        if self.maps is None:
            return np.zeros((self.full.height_px, self.full.width_px), np.bool_)
        u, v = self.maps
        inside = (u >= 0.0) & (u <= self.recorded.width_px - 1) & (v >= 0.0) & (v <= self.recorded.height_px - 1)
        return np.asarray(~inside)

    @cached_property
    def covered(self) -> Bool:
        """(H, W) of ``final``: True where a pixel is made of recorded pixels alone."""
        return np.asarray(self._resized(self.outside.astype(np.float32)) == 0.0)

    def image(self, recorded: UInt8) -> UInt8:
        """A recorded image (H, W, 3) in the final raster; black where the lens sees nothing.

        Undistorting is bilinear. A smaller raster takes the mean of what each pixel covers, a larger one is bilinear.
        """
        if self.maps is not None:
            recorded = np.asarray(
                cv2.remap(recorded, *self.maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.uint8
            )
        return np.asarray(self._resized(recorded), np.uint8)

    def mask(self, recorded: UInt8) -> UInt8:
        """A recorded mask (H, W) in the final raster: the value at each pixel's centre; 0 where the lens sees nothing.

        Raises:
            UsageError: the mask is of another size than the recorded image.
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
        """One step for both: a mask that is rounded to pixels twice would be off by up to one."""
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


@lru_cache(_HELD)
def image_raster(camera: Camera, undistort: bool, resize: Resize | None) -> ImageRaster:
    """The raster of a camera; those of 32 cameras are held, with their maps.

    Args:
        camera: as calibrated.
        undistort: to the pinhole of `mirror.geometry.undistorted`; a pinhole stays as it is.
        resize: of `resized_shape`.

    Raises:
        UsageError: the lens sees nothing that a pinhole can show.
    """
    full = undistorted(camera) if undistort and camera.model != "pinhole" else camera
    height, width = resized_shape((camera.height_px, camera.width_px), resize)
    return ImageRaster(camera, full, full.resized(width, height))


def resized_shape(shape: tuple[int, int], resize: Resize | None) -> tuple[int, int]:
    """Height and width of an image of some height and width after it is resized.

    Args:
        shape: (height, width).
        resize: (height, width) to come to, whatever the image's own proportions are; a factor for both, to the nearest
            whole pixel; None: as it is.
    """
    if resize is None:
        return shape
    if isinstance(resize, tuple):
        return resize
    return max(round(shape[0] * resize), 1), max(round(shape[1] * resize), 1)


def validate_resize(resize: object) -> Resize | None:
    """What `resized_shape` takes, of what a caller gave.

    Raises:
        UsageError: it is neither (height, width) nor a factor.
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
