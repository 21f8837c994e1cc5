"""Tracing by compiled kernels."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.threads import in_parallel
from hybridworldsim.rasterizer.buffers.traced import Traced
from hybridworldsim.rasterizer.cpu.blending.canvas import TILE_PX
from hybridworldsim.rasterizer.cpu.blending.sorting import depth_order
from hybridworldsim.rasterizer.cpu.blending.splats import FACTORS, FLOOR, LEVEL, placed_at, splats_of
from hybridworldsim.rasterizer.cpu.blending.tiles import tiles_of
from hybridworldsim.rasterizer.presets import TRANSMITTANCE_STOP, Preset
from hybridworldsim.rasterizer.projected import Projected
from mirror.arrays import Float32, Int32, Int64

_STOP = np.float32(TRANSMITTANCE_STOP)
_SLACK = np.float32(1e-2)
BLOCK_PX = 4
"""Side of a block of pixels: Gaussians that do not reach it are sorted out once for all of its pixels."""


def trace(
    projected: Projected, opacities: Tensor, width: int, height: int, *, preset: Preset, tile_size: int, top: int
) -> Traced:
    """What each pixel shows.

    Args:
        projected: M Gaussians.
        opacities: (M,) as blended.
        width: pixels.
        height: pixels.
        preset: whose cap of alpha.
        tile_size: pixels, as blended.
        top: how many Gaussians of greatest weight.
    """
    tiles_x, tiles_y = -(-width // TILE_PX), -(-height // TILE_PX)
    splats = splats_of(
        projected.means2d.detach().numpy(),
        projected.means2d_low.numpy(),
        projected.factors.numpy(),
        opacities.detach().numpy(),
        np.zeros((len(opacities), 1), np.float32),
        projected.radii.numpy(),
        tiles_x,
        tiles_y,
    )
    order = depth_order(projected.depths.detach().numpy())
    tiles = tiles_of(splats, order, tiles_x, np.ones(tiles_x * tiles_y, np.bool_))
    rows = np.full((height, width, top), -1, np.int64)
    weights = np.zeros((height, width, top), np.float32)
    number, median = np.zeros((height, width), np.int32), np.full((height, width), -1, np.int64)
    longest = int(np.diff(tiles.begins).max())

    def trace_blocks(block_y: int) -> None:
        _trace_blocks(
            block_y, tiles_x, tiles.begins, tiles.ids, splats.rows, splats.stride, preset.alpha_max,
            np.empty(longest, np.int32), rows, weights, number, median,
        )  # fmt: skip

    in_parallel(trace_blocks, -(-height // BLOCK_PX))
    return Traced(*map(torch.from_numpy, (rows, weights, number, median)))


@kernel()
def _trace_blocks(
    block_y: int,
    tiles_x: int,
    begins: Int64,
    ids: Int32,
    splats: Float32,
    stride: int,
    alpha_max: float,
    reaching: Int32,
    rows: Int64,
    weights: Float32,
    number: Int32,
    median: Int64,
) -> None:
    """Follow the light of a row of blocks of pixels.

    Args:
        block_y: number of the row.
        tiles_x: columns of tiles.
        begins: where the places of each tile begin.
        ids: the Gaussian at each place.
        splats: rows of the Gaussians.
        stride: of these rows.
        alpha_max: the greatest alpha.
        reaching: as long as the longest tile's list, for its own use.
        rows: (H, W, top) written.
        weights: (H, W, top) written, 0 before.
        number: (H, W) written, 0 before.
        median: (H, W) written.
    """
    height, width, top = rows.shape
    cap, half = np.float32(alpha_max), np.float32(0.5)
    from_centre = np.float32(0.5 * (BLOCK_PX - 1))
    for block_x in range((width + BLOCK_PX - 1) // BLOCK_PX):
        tile = block_y * BLOCK_PX // TILE_PX * tiles_x + block_x * BLOCK_PX // TILE_PX
        centre_x = np.float32(block_x * BLOCK_PX + BLOCK_PX // 2)
        centre_y = np.float32(block_y * BLOCK_PX + BLOCK_PX // 2)
        count = 0
        for place in range(begins[tile], begins[tile + 1]):
            row = ids[place] * stride
            u, v = placed_at(splats, row, centre_x, centre_y)
            reach = math.sqrt(splats[row + LEVEL] - FLOOR) + _SLACK
            wide = from_centre * (splats[row + FACTORS] + abs(splats[row + FACTORS + 1]))
            high = from_centre * splats[row + FACTORS + 2]
            if abs(u) <= reach + wide and abs(v) <= reach + high:
                reaching[count] = ids[place]
                count += 1
        for y in range(block_y * BLOCK_PX, min((block_y + 1) * BLOCK_PX, height)):
            for x in range(block_x * BLOCK_PX, min((block_x + 1) * BLOCK_PX, width)):
                light = np.float32(1.0)
                for place in range(count):
                    row = reaching[place] * stride
                    u, v = placed_at(splats, row, np.float32(x) + half, np.float32(y) + half)
                    exponent = splats[row + LEVEL] - u * u - v * v
                    if exponent < FLOOR:
                        continue
                    weight = light * min(np.exp2(exponent), cap)
                    behind = light - weight
                    if behind <= _STOP:
                        break
                    number[y, x] += 1
                    if light > half and behind <= half:
                        median[y, x] = reaching[place]
                    light = behind
                    # the least of those named gives way; a nearer one stays before an equal
                    rank = top
                    while rank > 0 and weight > weights[y, x, rank - 1]:
                        rank -= 1
                        if rank + 1 < top:
                            weights[y, x, rank + 1] = weights[y, x, rank]
                            rows[y, x, rank + 1] = rows[y, x, rank]
                    if rank < top:
                        weights[y, x, rank], rows[y, x, rank] = weight, reaching[place]
