"""The input of the rasteriser for a camera: a ray for every pixel, and cones around the rays of tiles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera
from mirror.portable import arrays
from mirror.synth.render.develop.motion import ImageJacobian, compute_image_jacobian

TILE_PX: Final = 8
LEVELS: Final = 4
FANOUT: Final = 4
"""A tile of one level is FANOUT tiles of the next finer level wide; the finest tiles are TILE_PX wide."""
_MARGIN_PX: Final = 1.0


@dataclass(frozen=True, eq=False)
class Lens:
    """The rays of a camera.

    Attributes:
        rays: (H, W, 3) unit directions through the pixel centres, camera frame.
        cones: (C, 5) axis, cosine and sine of the half angle of a cone that contains all rays of a tile with a margin
            of one pixel; level by level, the finest first, each in row-major order.
        levels: (LEVELS, 3) index of the first cone of a level, and its numbers of tiles down and across.
        pixel_rad: angle between neighbouring rays in the middle of the image.
    """

    rays: Float64
    cones: Float64
    levels: Int64
    pixel_rad: float

    @cached_property
    def jacobian(self) -> ImageJacobian:
        """The Jacobian from directions to pixels."""
        return compute_image_jacobian(self.rays)


def make_lens(camera: Camera) -> Lens:
    """Compute the rays of a camera, and cones around the rays of its tiles.

    Raises:
        UsageError: the camera has a pixel without a ray.
    """
    rays = camera.rays()
    if not rays.valid.all():
        row, column = np.argwhere(~rays.valid)[0]
        raise UsageError(f"no ray at pixel ({column}, {row})", expected="a lens that fills its raster")
    height, width = rays.direction.shape[:2]
    steps = [np.linalg.norm(np.diff(rays.direction, axis=axis), axis=2) for axis in (0, 1)]
    # The focal length does not give the pixel's angle for every camera model.
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
    apart = float(arrays.arccos(min(arrays.matmul(middle[0], middle[-1]), 1.0))) or 1.0 / camera.fx_px
    return Lens(np.ascontiguousarray(rays.direction), np.concatenate(cones), levels, apart)


def _cones(rays: Float64, side: int, margin_rad: float) -> Float64:
    height, width = rays.shape[:2]
    down, across = -(-height // side), -(-width // side)
    # Tiles that extend over the edge of the image repeat its last rays, which keeps their cones tight.
    padded = np.pad(rays, ((0, down * side - height), (0, across * side - width), (0, 0)), "edge")
    tiles = padded.reshape(down, side, across, side, 3).swapaxes(1, 2).reshape(down * across, side * side, 3)
    axes = tiles.sum(axis=1)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    nearest = np.einsum("tri,ti->tr", tiles, axes).min(axis=1)
    half = arrays.arccos(np.clip(nearest, -1.0, 1.0)) + margin_rad
    return np.column_stack([axes, arrays.cos(half), arrays.sin(half)])
