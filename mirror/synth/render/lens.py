"""The input of the rasteriser for a camera: a ray for every pixel, and cones around the rays of tiles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int32, Int64
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera
from mirror.portable import arrays, scalars
from mirror.synth.render.develop.motion import ImageJacobian, compute_image_jacobian

TILE_PX: Final = 8
LEVELS: Final = 4
FANOUT: Final = 4
"""A tile of one level is FANOUT tiles of the next finer level wide; the finest tiles are TILE_PX wide."""
_MARGIN_PX: Final = 1.0
_NO_CELLS: Final = (np.zeros((2, 7), np.int64), np.zeros(0, np.int32), np.zeros(2))
_MOST_TILES: Final = 600
"""Images with more tiles have no cells: at their scale few surfaces are small beside a tile."""
_MOST_CELLS: Final = 64
_SMALL_TILES: Final = (0.25, 3.0)
"""Surfaces up to so many times as large as a tile are looked up in the cells: they rarely hide a whole tile. Most are
of the first size, for which a cell has a fifth of the tiles of the second."""
_MOST_SMALL: Final = 0.5


@dataclass(frozen=True, eq=False)
class Lens:
    """The rays of a camera.

    Attributes:
        rays: (H, W, 3) unit directions through the pixel centres, camera frame.
        cones: (C, 5) axis, cosine and sine of the half angle of a cone that contains all rays of a tile with a margin
            of one pixel; level by level, the finest first, each in row-major order.
        levels: (LEVELS, 3) index of the first cone of a level, and its numbers of tiles down and across.
        pixel_rad: angle between neighbouring rays in the middle of the image.
        cells: (2, 6 S^2 + 1) for each of two sizes, index of the first tile of each cell of directions: the cells of
            the S x S grids on the faces +x, -x, +y, -y, +z, -z of a cube, row by row.
        cell_tiles: tiles whose cones come within the angle of a size of some direction of the cell.
        small: (2,) sizes, the smaller first: sines of the half angles of the largest surfaces whose tiles the cells
            list; 0: there are no cells.
    """

    rays: Float64
    cones: Float64
    levels: Int64
    pixel_rad: float
    cells: Int64
    cell_tiles: Int32
    small: Float64

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
    middle = rays.direction[height // 2, max(width // 2 - 1, 0) : width // 2 + 1]
    apart = float(arrays.arccos(min(arrays.matmul(middle[0], middle[-1]), 1.0))) or 1.0 / camera.fx_px
    return _lens_of_rays(np.ascontiguousarray(rays.direction), apart, 1.0 / camera.fx_px, with_cells=True)


def cut_line(lens: Lens, line: int, *, column: bool) -> tuple[Lens, int]:
    """Cut one row or column out of a lens, with its neighbours, which give the width of its pixels.

    Args:
        lens: the lens.
        line: index of the row or column.
        column: whether it is a column.

    Returns:
        The lens of up to three lines, and the place of the line in it.
    """
    first, last = max(line - 1, 0), line + 2
    rays = lens.rays[:, first:last] if column else lens.rays[first:last]
    # a table of cells takes longer than it saves in one line
    return _lens_of_rays(np.ascontiguousarray(rays), lens.pixel_rad, lens.pixel_rad, with_cells=False), line - first


def _lens_of_rays(rays: Float64, pixel_rad: float, least_rad: float, *, with_cells: bool) -> Lens:
    """Compute the cones of rays (H, W, 3); the margin of a single ray's tile is ``least_rad``."""
    height, width = rays.shape[:2]
    steps = [np.linalg.norm(np.diff(rays, axis=axis), axis=2) for axis in (0, 1)]
    # The focal length does not give the pixel's angle for every camera model.
    widest = max(float(step.max(initial=0.0)) for step in steps) or least_rad
    cones, levels = [], np.zeros((LEVELS, 3), np.int64)
    start = 0
    for level in range(LEVELS):
        side = TILE_PX * FANOUT**level
        down, across = -(-height // side), -(-width // side)
        levels[level] = start, down, across
        start += down * across
        cones.append(_cones(rays, side, _MARGIN_PX * widest))
    cells, cell_tiles, small = make_cells(cones[0]) if with_cells else _NO_CELLS
    return Lens(rays, np.concatenate(cones), levels, pixel_rad, cells, cell_tiles, small)


def make_cells(tiles: Float64) -> tuple[Int64, Int32, Float64]:
    """List, for cells of directions, the tiles that a small surface in such a direction may touch.

    Args:
        tiles: (T, 5) axis, cosine and sine of the half angle of the cones of the finest tiles.

    Returns:
        The ``cells``, ``cell_tiles`` and ``small`` of a lens.
    """
    if len(tiles) > _MOST_TILES or tiles[:, 3].min() < 0.5:
        return _NO_CELLS
    least = float(tiles[:, 4].min())
    small = np.minimum(np.array(_SMALL_TILES) * least, _MOST_SMALL)
    side = min(int(2.0 / least) + 1, _MOST_CELLS)
    edges = np.linspace(-1.0, 1.0, side + 1)
    middle = 0.5 * (edges[:-1] + edges[1:])
    across, down = np.meshgrid(middle, middle)
    axes = []
    for face in range(6):
        axis, sign = face // 2, 1.0 - 2.0 * (face % 2)
        first, second = (other for other in range(3) if other != axis)
        grid = np.empty((side, side, 3))
        grid[..., axis], grid[..., first], grid[..., second] = sign, across, down
        axes.append((grid / np.linalg.norm(grid, axis=2, keepdims=True)).reshape(-1, 3))
    # No direction of a cell is farther from its middle than its corners, at most this far on the plane of its face.
    half = 1.5 / side
    between = np.einsum("ci,ti->ct", np.concatenate(axes), tiles[:, :3])
    begins, listed, total = np.zeros((2, 6 * side * side + 1), np.int64), [], 0
    for size, sine in enumerate(small):
        touches = between >= arrays.cos(half + arrays.arcsin(tiles[:, 4]) + scalars.asin(float(sine)))
        begins[size] = total + np.concatenate([[0], np.cumsum(touches.sum(axis=1))])
        listed.append(np.nonzero(touches)[1].astype(np.int32))
        total += len(listed[-1])
    return begins, np.concatenate(listed), small


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
