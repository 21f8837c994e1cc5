"""Heights of the ground: finds the triangle below a point through a grid of cells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit

from mirror.arrays import Float64, Int64
from mirror.compiled import inner_njit
from mirror.errors import UsageError

_CELL_M: Final = 4.0
_MARGIN: Final = 1e-9


@dataclass(frozen=True)
class GroundIndex:
    """The ground's triangles, indexed by the cells of a grid.

    Attributes:
        triangles: (T, 3, 3) corners, metres, counter-clockwise from above.
        low: (2,) lower corner of the grid, metres.
        shape: number of cells along x and y.
        first: (cells + 1,) index in ``members`` of each cell's first triangle.
        members: triangle indices, grouped by cell.
    """

    triangles: Float64
    low: Float64
    shape: tuple[int, int]
    first: Int64
    members: Int64

    def height_m(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> Float64:
        """Return the heights (...,) of the ground at positions; on a kerb's edge, the higher of the two.

        Raises:
            UsageError: a position is outside the ground, or not finite.
        """
        x, y = np.broadcast_arrays(np.asarray(x_m, np.float64), np.asarray(y_m, np.float64))
        shape = x.shape
        points = np.stack([x.ravel(), y.ravel()], axis=1)
        heights = _find_heights(
            self.triangles, self.low, self.shape[0], self.shape[1], self.first, self.members, points
        )
        if np.isnan(heights).any():
            place = points[int(np.argmax(np.isnan(heights)))]
            raise UsageError(
                "the ground has no triangle at this position",
                place=f"({place[0]:.3f}, {place[1]:.3f})",
                expected="a position within the scene",
            )
        return heights.reshape(shape)


def build_ground_index(triangles: Float64) -> GroundIndex:
    """Build the grid of cells over triangles (T, 3, 3)."""
    low = triangles[:, :, :2].min(axis=(0, 1))
    span = triangles[:, :, :2].max(axis=(0, 1)) - low
    nx, ny = (int(n) for n in np.ceil(span / _CELL_M + 1e-9))
    first, members = _bin_triangles(np.ascontiguousarray(triangles), low, max(nx, 1), max(ny, 1))
    return GroundIndex(triangles, low, (max(nx, 1), max(ny, 1)), first, members)


@inner_njit
def _overlaps_cell(triangle: Float64, left: float, bottom: float) -> bool:
    """Return whether a triangle (3, 3) overlaps the cell with this lower left corner; tests its edges' half planes."""
    for corner in range(3):
        other = (corner + 1) % 3
        ax, ay = triangle[corner, 0], triangle[corner, 1]
        dx, dy = triangle[other, 0] - ax, triangle[other, 1] - ay
        # The cell's corner farthest to the left of the edge.
        x = left if dy > 0.0 else left + _CELL_M
        y = bottom + _CELL_M if dx > 0.0 else bottom
        if dx * (y - ay) - dy * (x - ax) < -1e-6:
            return False
    return True


@inner_njit
def _cell_range(triangle: Float64, axis: int, low: float, count: int) -> tuple[int, int]:
    least = min(triangle[0, axis], triangle[1, axis], triangle[2, axis])
    most = max(triangle[0, axis], triangle[1, axis], triangle[2, axis])
    start = math.floor((least - low - 1e-6) / _CELL_M)
    stop = math.floor((most - low + 1e-6) / _CELL_M)
    return max(start, 0), min(stop, count - 1)


@njit(cache=True, nogil=True)
def _bin_triangles(triangles: Float64, low: Float64, nx: int, ny: int) -> tuple[Int64, Int64]:
    first = np.zeros(nx * ny + 1, np.int64)
    members = np.zeros(0, np.int64)
    for turn in range(2):
        fill = first[:-1].copy()
        for number in range(len(triangles)):
            triangle = triangles[number]
            i0, i1 = _cell_range(triangle, 0, low[0], nx)
            j0, j1 = _cell_range(triangle, 1, low[1], ny)
            for j in range(j0, j1 + 1):
                for i in range(i0, i1 + 1):
                    if _overlaps_cell(triangle, low[0] + i * _CELL_M, low[1] + j * _CELL_M):
                        if turn == 0:
                            first[j * nx + i + 1] += 1
                        else:
                            members[fill[j * nx + i]] = number
                            fill[j * nx + i] += 1
        if turn == 0:
            first = np.cumsum(first)
            members = np.zeros(first[-1], np.int64)
    return first, members


@njit(cache=True, nogil=True)
def _find_heights(
    triangles: Float64, low: Float64, nx: int, ny: int, first: Int64, members: Int64, points: Float64
) -> Float64:
    heights = np.full(len(points), np.nan)
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        if not (math.isfinite(x) and math.isfinite(y)):
            continue
        i, j = math.floor((x - low[0]) / _CELL_M), math.floor((y - low[1]) / _CELL_M)
        if i < 0 or j < 0 or i >= nx or j >= ny:
            continue
        for place in range(first[j * nx + i], first[j * nx + i + 1]):
            t = triangles[members[place]]
            ax, ay = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1]
            bx, by = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1]
            px, py = x - t[0, 0], y - t[0, 1]
            area = ax * by - ay * bx
            s, w = (px * by - py * bx) / area, (ax * py - ay * px) / area
            if s >= -_MARGIN and w >= -_MARGIN and s + w <= 1.0 + _MARGIN:
                z = t[0, 2] + s * (t[1, 2] - t[0, 2]) + w * (t[2, 2] - t[0, 2])
                if math.isnan(heights[k]) or z > heights[k]:
                    heights[k] = z
    return heights
