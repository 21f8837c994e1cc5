"""Rays of the samples of a tile's pixels, in the world frame."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mirror.arrays import Float32, Float64
from mirror.compiled import inner_per_pixel
from mirror.portable import scalars
from mirror.synth.render.lens import TILE_PX

_TURN: Final = scalars.atan(0.5)
OFFSETS: Final = np.array(
    [(0.0, 0.0)]
    + [
        (
            scalars.cos(_TURN) * i / 3.0 - scalars.sin(_TURN) * j / 3.0,
            scalars.sin(_TURN) * i / 3.0 + scalars.cos(_TURN) * j / 3.0,
        )
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
        if i or j
    ],
    np.float32,
)
"""Rays of a pixel: the first passes through its centre and gives the ground truth, the others form a rotated grid."""


@inner_per_pixel()
def ray_steps(
    rays: Float64, rotation: Float64, top: int, left: int, bottom: int, right: int
) -> tuple[float, float, float, float, float, float]:
    """Return the change of a tile's rays from pixel to pixel, to the right and downwards, in the world frame."""
    row, column = (top + bottom) // 2, (left + right) // 2
    over, under = (left, right) if right > left else (max(left - 1, 0), right)
    above, below = (top, bottom) if bottom > top else (max(top - 1, 0), bottom)
    wide, high = 1.0 / max(under - over, 1), 1.0 / max(below - above, 1)
    i, j, k = (
        rays[row, under, 0] - rays[row, over, 0],
        rays[row, under, 1] - rays[row, over, 1],
        rays[row, under, 2] - rays[row, over, 2],
    )
    p, q, r = (
        rays[below, column, 0] - rays[above, column, 0],
        rays[below, column, 1] - rays[above, column, 1],
        rays[below, column, 2] - rays[above, column, 2],
    )
    return (
        wide * (rotation[0, 0] * i + rotation[0, 1] * j + rotation[0, 2] * k),
        wide * (rotation[1, 0] * i + rotation[1, 1] * j + rotation[1, 2] * k),
        wide * (rotation[2, 0] * i + rotation[2, 1] * j + rotation[2, 2] * k),
        high * (rotation[0, 0] * p + rotation[0, 1] * q + rotation[0, 2] * r),
        high * (rotation[1, 0] * p + rotation[1, 1] * q + rotation[1, 2] * r),
        high * (rotation[2, 0] * p + rotation[2, 1] * q + rotation[2, 2] * r),
    )


@inner_per_pixel()
def spread_rays(
    rays: Float64, rotation: Float64, offsets: Float32, top: int, left: int, sx: Float32, sy: Float32, sz: Float32
) -> tuple[float, float, float, float, float, float]:
    """Fill in the tile's rays in the world frame; the lens is taken as linear within a pixel.

    Row by row, and in a row sample by sample, so that the rays of some rows follow each other.

    Returns:
        The change of the rays from pixel to pixel, to the right and downwards.
    """
    height, width = rays.shape[:2]
    bottom, right = min(top + TILE_PX, height) - 1, min(left + TILE_PX, width) - 1
    ax, ay, az, bx, by, bz = ray_steps(rays, rotation, top, left, bottom, right)
    run = len(offsets) * TILE_PX
    for pixel in range(TILE_PX * TILE_PX):
        row, column = min(top + pixel // TILE_PX, bottom), min(left + pixel % TILE_PX, right)
        a, b, c = rays[row, column, 0], rays[row, column, 1], rays[row, column, 2]
        at = pixel // TILE_PX * run + pixel % TILE_PX
        sx[at] = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
        sy[at] = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
        sz[at] = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2] * c
    # The first sample comes last, because the other samples start from the values at the pixel centres.
    for sample in range(len(offsets) - 1, -1, -1):
        u, v = offsets[sample, 0], offsets[sample, 1]
        x = np.float32(u * ax + v * bx)
        y = np.float32(u * ay + v * by)
        z = np.float32(u * az + v * bz)
        for row in range(TILE_PX):
            centre, first = row * run, row * run + sample * TILE_PX
            for column in range(TILE_PX):
                sx[first + column] = sx[centre + column] + x
                sy[first + column] = sy[centre + column] + y
                sz[first + column] = sz[centre + column] + z
    return ax, ay, az, bx, by, bz


@inner_per_pixel()
def unit_normal(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> tuple[float, float, float]:
    """Return the unit vector perpendicular to two vectors; 0 if they are parallel."""
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    size = math.sqrt(x * x + y * y + z * z)
    scale = 1.0 / size if size > 0.0 else 0.0
    return scale * x, scale * y, scale * z
