"""A camera as the rasteriser takes it: a ray for every pixel, and cones about the rays of tiles of several sizes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera
from mirror.synth.render.develop.motion import ImageJacobian, compute_image_jacobian

TILE_PX: Final = 8
LEVELS: Final = 4
FANOUT: Final = 4
"""A tile of one level is as wide as so many of the next finer one; the finest are TILE_PX wide."""
_MARGIN_PX: Final = 1.0


@dataclass(frozen=True, eq=False)
class Lens:
    """The rays of a camera.

    Attributes:
        rays: (H, W, 3) unit directions through the pixel centres, camera frame.
        cones: (C, 5) axis, cosine and sine of the half angle of a cone that holds all rays of a tile and a pixel
            beyond; level by level, the finest first, each in row-major order.
        levels: (LEVELS, 3) where a level's cones begin, and its tiles down and across.
        pixel_rad: angle between neighbouring rays in the middle.
    """

    rays: Float64
    cones: Float64
    levels: Int64
    pixel_rad: float

    @cached_property
    def jacobian(self) -> ImageJacobian:
        """How directions become pixels."""
        return compute_image_jacobian(self.rays)


def make_lens(camera: Camera) -> Lens:
    """The rays of a camera, and cones about its tiles.

    Raises:
        UsageError: the camera has a pixel that nothing is imaged at.
    """
    rays = camera.rays()
    if not rays.valid.all():
        row, column = np.argwhere(~rays.valid)[0]
        raise UsageError(f"no ray at pixel ({column}, {row})", expected="a lens that fills its raster")
    height, width = rays.direction.shape[:2]
    steps = [np.linalg.norm(np.diff(rays.direction, axis=axis), axis=2) for axis in (0, 1)]
    # Focal lengths of some models are no measure of it.
    widest = max(float(step.max(initial=0.0)) for step in steps) or 1.0 / camera.fx_px
    cones, levels = [], np.zeros((LEVELS, 3), np.int64)
    start = 0
    for level in range(LEVELS):
        side = TILE_PX * FANOUT**level
        down, across = -(-height // side), -(-width // side)
        levels[level] = start, down, across
        start += down * across
        cones.append(_cones(rays.direction, side, _MARGIN_PX * widest))
    middle = rays.direction[height // 2, max(width // 2 - 1, 0) : width // 2 + 1]
    apart = float(np.arccos(min(middle[0] @ middle[-1], 1.0))) or 1.0 / camera.fx_px
    return Lens(np.ascontiguousarray(rays.direction), np.concatenate(cones), levels, apart)


def _cones(rays: Float64, side: int, margin_rad: float) -> Float64:
    height, width = rays.shape[:2]
    down, across = -(-height // side), -(-width // side)
    # Tiles that stick out repeat the rays of their edge: the cone about them holds what is there.
    padded = np.pad(rays, ((0, down * side - height), (0, across * side - width), (0, 0)), "edge")
    tiles = padded.reshape(down, side, across, side, 3).swapaxes(1, 2).reshape(down * across, side * side, 3)
    axes = tiles.sum(axis=1)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    nearest = np.einsum("tri,ti->tr", tiles, axes).min(axis=1)
    half = np.arccos(np.clip(nearest, -1.0, 1.0)) + margin_rad
    return np.column_stack([axes, np.cos(half), np.sin(half)])
