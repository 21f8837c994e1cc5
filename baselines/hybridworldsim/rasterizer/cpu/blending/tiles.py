"""Pairs Gaussians with the tiles that their ellipses reach; the pairs of a tile are in depth order."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.memory import empty_aligned
from hybridworldsim.kernels.threads import in_parallel, spans
from hybridworldsim.kernels.vectors import prefetch
from hybridworldsim.rasterizer.cpu.blending.canvas import TILE_PX
from hybridworldsim.rasterizer.cpu.blending.splats import FLOOR, LEVEL, MEAN, MEAN_LOW, Splats, load_factors
from hybridworldsim.rasterizer.limits import refuse_too_many_pairs
from mirror.arrays import AnyArray, Bool, Float32, Int32, Int64

PREFETCH_DISTANCE: Final = 12
"""Number of extra ids after the last pair: a row is prefetched this number of pairs before it is needed."""
_ORDER_PREFETCH_DISTANCE: Final = 16
_SLACK_PX: Final = 0.01


class Tiles(NamedTuple):
    """Pairs of a tile and a Gaussian.

    Attributes:
        tile_starts: (T + 1,) index of the first pair of each tile, T tiles row by row.
        ids: (P + PREFETCH_DISTANCE,) Gaussian of each pair, then zeros.
        pair_ranks: (P,) number of earlier pairs of the same Gaussian, tile by tile.
        pairs: (R,) number of pairs of each of R Gaussians in depth order.
    """

    tile_starts: Int64
    ids: Int32
    pair_ranks: Int32
    pairs: Int64


def assign_tiles(splats: Splats, order: Int32, tiles_x: int, alive: Bool) -> Tiles:
    """Pair Gaussians with tiles.

    Args:
        splats: the Gaussians.
        order: (R,) indices of the Gaussians to pair, in depth order.
        tiles_x: columns of tiles.
        alive: (T,) tiles that are not done.

    Raises:
        UsageError: more than `PAIRS_MAX` pairs.
    """
    edges = spans(len(order))
    parts = len(edges) - 1
    # a part writes at most one tile after its last
    starts, boxes, alive_sums = np.ones(parts + 1, np.int64), splats.boxes, _integral_image(alive, tiles_x)
    starts[0] = 0
    in_parallel(
        lambda part: _count_box_tiles(edges[part], edges[part + 1], order, boxes, alive_sums, starts[part + 1 :]),
        parts,
    )
    np.cumsum(starts, out=starts)
    refuse_too_many_pairs(int(starts[-1]))
    tile_list = empty_aligned(starts[-1], np.int32)
    pairs, places = np.empty(len(order), np.int64), np.zeros((parts, len(alive)), np.int64)

    def list_part(part: int) -> None:
        _list_tiles(
            edges[part], edges[part + 1], order, boxes, alive_sums, splats.rows, splats.stride, tiles_x, alive,
            tile_list, starts[part], pairs, places[part],
        )  # fmt: skip

    in_parallel(list_part, parts)
    counts = places.sum(axis=0)
    tile_starts = np.concatenate([[0], np.cumsum(counts)])
    np.cumsum(places, axis=0, out=places)
    places[1:], places[0] = places[:-1].copy(), 0
    places += tile_starts[:-1]
    ids, pair_ranks = (
        empty_aligned(tile_starts[-1] + PREFETCH_DISTANCE, np.int32),
        empty_aligned(tile_starts[-1], np.int32),
    )
    ids[tile_starts[-1] :] = 0

    def sort_part(part: int) -> None:
        _sort_by_tile(
            edges[part], edges[part + 1], order, tile_list, starts[part], pairs, places[part], ids, pair_ranks
        )

    in_parallel(sort_part, parts)
    return Tiles(tile_starts, ids, pair_ranks, pairs)


def _integral_image(alive: Bool, tiles_x: int) -> Int32:
    """Count the living tiles above and left of each corner: (tiles_y + 1, tiles_x + 1)."""
    sums = np.zeros((len(alive) // tiles_x + 1, tiles_x + 1), np.int32)
    np.cumsum(np.cumsum(alive.reshape(-1, tiles_x), axis=0), axis=1, out=sums[1:, 1:])
    return sums


@kernel(inline="always")
def _count_alive(alive_sums: Int32, x0: Any, x1: Any, y0: Any, y1: Any) -> Any:
    """Count the living tiles of a box."""
    return np.int64(alive_sums[y1, x1]) - alive_sums[y0, x1] - alive_sums[y1, x0] + alive_sums[y0, x0]


@kernel()
def _count_box_tiles(begin: int, end: int, order: Int32, boxes: AnyArray, alive_sums: Int32, counts: Int64) -> None:
    """Add the numbers of living tiles of boxes to a count."""
    total = 0
    for rank in range(begin, end):
        prefetch(boxes, order[min(rank + _ORDER_PREFETCH_DISTANCE, end - 1)] * 4)
        i = order[rank]
        total += _count_alive(alive_sums, boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3])
    counts[0] += total


@kernel()
def _list_tiles(
    begin: int,
    end: int,
    order: Int32,
    boxes: AnyArray,
    alive_sums: Int32,
    rows: Float32,
    stride: int,
    tiles_x: int,
    alive: Bool,
    tile_list: Int32,
    start: int,
    pairs: Int64,
    counts: Int64,
) -> None:
    """List the living tiles of each Gaussian."""
    place = start
    for rank in range(begin, end):
        soon = order[min(rank + _ORDER_PREFETCH_DISTANCE, end - 1)]
        prefetch(rows, soon * stride)
        prefetch(boxes, soon * 4)
        i = order[rank]
        row = i * stride
        x0, x1 = np.int64(boxes[i, 0]), np.int64(boxes[i, 1])
        y0, y1 = np.int64(boxes[i, 2]), np.int64(boxes[i, 3])
        pairs[rank] = 0
        if _count_alive(alive_sums, x0, x1, y0, y1) == 0:
            continue
        before = place
        # an ellipse reaches all tiles of a box that is one tile wide or high
        if x1 - x0 < 2 or y1 - y0 < 2:
            for y in range(y0, y1):
                for x in range(x0, x1):
                    tile = y * tiles_x + x
                    tile_list[place] = tile
                    counts[tile] += alive[tile]
                    place += alive[tile]
        else:
            mean_x = np.float64(rows[row + MEAN]) + rows[row + MEAN_LOW]
            mean_y = np.float64(rows[row + MEAN + 1]) + rows[row + MEAN_LOW + 1]
            f11, f12, f22 = load_factors(rows, row)
            square = np.float64(rows[row + LEVEL]) - FLOOR
            high = math.sqrt(square) / f22
            slope, wide, steep = f12 / f11, 1.0 / f11, f22 * f22
            # y at which the ellipse is farthest right; it is farthest left at -y
            right = -f12 * high / math.sqrt(f12 * f12 + steep)
            for y in range(y0, y1):
                low_y = max(y * TILE_PX + (0.5 - _SLACK_PX) - mean_y, -high)
                high_y = min((y + 1) * TILE_PX - (0.5 - _SLACK_PX) - mean_y, high)
                if low_y > high_y:
                    continue
                at_right, at_left = min(max(right, low_y), high_y), min(max(-right, low_y), high_y)
                x_right = math.sqrt(max(square - steep * at_right * at_right, 0.0)) * wide - slope * at_right
                x_left = -math.sqrt(max(square - steep * at_left * at_left, 0.0)) * wide - slope * at_left
                from_x = (mean_x + x_left + (0.5 - _SLACK_PX)) * (1.0 / TILE_PX)
                to_x = (mean_x + x_right - (0.5 - _SLACK_PX)) * (1.0 / TILE_PX) + 1.0
                first_x: Any = max(x0, int(min(max(from_x, 0.0), 1e6)))
                last_x: Any = min(x1, int(min(max(to_x, 0.0), 1e6)))
                for x in range(first_x, last_x):
                    tile = y * tiles_x + x
                    tile_list[place] = tile
                    counts[tile] += alive[tile]
                    place += alive[tile]
        pairs[rank] = place - before


@kernel()
def _sort_by_tile(
    begin: int,
    end: int,
    order: Int32,
    tile_list: Int32,
    start: int,
    pairs: Int64,
    places: Int64,
    ids: Int32,
    pair_ranks: Int32,
) -> None:
    """Sort pairs by tile; `places` has the index of this part's next pair of each tile."""
    at = start
    for rank in range(begin, end):
        for turn in range(pairs[rank]):
            tile = tile_list[at + turn]
            place = places[tile]
            places[tile] = place + 1
            ids[place], pair_ranks[place] = order[rank], turn
        at += pairs[rank]
