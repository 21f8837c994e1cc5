"""Finds the rows and columns of a tile's pixels that a surface may touch."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Float32, Float64, Int64
from mirror.compiled import inner_per_pixel
from mirror.synth.render.lens import TILE_PX

_INEXACT: Final = 2e-6
"""Bound of the rounding to float32 in a dot product of a ray and a unit vector."""


@inner_per_pixel()
def list_edges(
    rows: Float32, first: int, last: int, cx: float, cy: float, cz: float, sine: float, crossed: Int64
) -> int:
    """List the edges of a face that cross a tile; returns their number, or -1 if the tile lies outside an edge.

    A sine above 1 is that of no cone.
    """
    edges = 0
    for edge in range(first + 1, last):
        out = rows[edge, 0] * cx + rows[edge, 1] * cy + rows[edge, 2] * cz
        if out < -sine:
            return -1
        if out < sine:
            crossed[edges] = edge
            edges += 1
    return edges


@inner_per_pixel()
def find_rows(
    rows: Float32, first: int, crossed: Int64, edges: int, px: Float32, py: Float32, pz: Float32,
    ax: float, ay: float, az: float, bx: float, by: float, bz: float, spread: float, reach: Float32,
    ahead: Float32,
) -> tuple[int, int]:  # fmt: skip
    """Find the rows of pixels that a face may touch, and where rays hit nothing nearer.

    A ray of a pixel is its first one and at most ``spread`` times the steps to its neighbours, so that the dot product
    with a row of coefficients changes by no more than that.

    Args:
        rows: coefficients of `binning.fill_ray_tests`.
        first: first row of the face.
        crossed: from `list_edges`.
        edges: number of edges that cross the tile.
        px: x of the first rays of the pixels.
        py: y.
        pz: z.
        ax: change of the rays from pixel to pixel, to the right.
        ay: to the right.
        az: to the right.
        bx: downwards.
        by: downwards.
        bz: downwards.
        spread: largest difference of a pixel's offsets from its first, pixels.
        reach: least inverse distances of the rays of the pixels.
        ahead: buffer of a number for each pixel.

    Returns:
        The first row, and the one behind the last; the same if there are none.
    """
    a, b, c = rows[first, 0], rows[first, 1], rows[first, 2]
    slack = spread * (abs(a * ax + b * ay + c * az) + abs(a * bx + b * by + c * bz))
    more = np.float32(slack + _INEXACT * (abs(a) + abs(b) + abs(c)))
    count = len(px)
    for i in range(count):
        ahead[i] = a * px[i] + b * py[i] + c * pz[i] + more - reach[i]
    for at in range(edges):
        a, b, c = rows[crossed[at], 0], rows[crossed[at], 1], rows[crossed[at], 2]
        slack = spread * (abs(a * ax + b * ay + c * az) + abs(a * bx + b * by + c * bz))
        more = np.float32(slack + _INEXACT)
        for i in range(count):
            ahead[i] = min(ahead[i], a * px[i] + b * py[i] + c * pz[i] + more)
    upper, lower = 0, count // TILE_PX
    while upper < lower and not _is_any_ahead(ahead, upper):
        upper += 1
    while lower > upper and not _is_any_ahead(ahead, lower - 1):
        lower -= 1
    return upper, lower


@inner_per_pixel()
def _is_any_ahead(ahead: Float32, row: int) -> bool:
    found = 0
    for column in range(TILE_PX):
        found |= ahead[row * TILE_PX + column] >= np.float32(0.0)
    return found > 0


@inner_per_pixel()
def bound_lines(
    sx: Float32, sy: Float32, sz: Float32, run: int, ux: float, uy: float, uz: float, vx: float, vy: float, vz: float,
    lines: Float64,
) -> None:  # fmt: skip
    """Bound the dot products of the first rays of pixels with u in each column, and with v in each row.

    Args:
        sx: x of the rays of a tile.
        sy: y.
        sz: z.
        run: number of rays in a row.
        ux: x of u.
        uy: y of u.
        uz: z of u.
        vx: x of v.
        vy: y of v.
        vz: z of v.
        lines: (2, 2, TILE_PX) output: least and greatest in each column, and in each row.
    """
    for line in range(TILE_PX):
        lines[0, 0, line], lines[0, 1, line], lines[1, 0, line], lines[1, 1, line] = np.inf, -np.inf, np.inf, -np.inf
    for row in range(TILE_PX):
        for column in range(TILE_PX):
            i = row * run + column
            u, v = ux * sx[i] + uy * sy[i] + uz * sz[i], vx * sx[i] + vy * sy[i] + vz * sz[i]
            lines[0, 0, column], lines[0, 1, column] = min(lines[0, 0, column], u), max(lines[0, 1, column], u)
            lines[1, 0, row], lines[1, 1, row] = min(lines[1, 0, row], v), max(lines[1, 1, row], v)


@inner_per_pixel()
def find_lines(bounds: Float64, at: float, apart: float) -> tuple[int, int]:
    """Return the first line with a dot product within ``apart`` of ``at``, and the one behind the last."""
    start, stop = 0, TILE_PX
    while start < stop and bounds[1, start] < at - apart:
        start += 1
    while stop > start and bounds[0, stop - 1] > at + apart:
        stop -= 1
    return start, stop
