"""Tracing by compiled kernels."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.rasterizer.buffers.traced import Traced
from hybridworldsim.rasterizer.cpu.canvas import TILE_PX
from hybridworldsim.rasterizer.cpu.kernels import kernel
from hybridworldsim.rasterizer.cpu.sorting import depth_order
from hybridworldsim.rasterizer.cpu.splats import FACTORS, FLOOR, LEVEL, MEAN, MEAN_LOW, splats_of
from hybridworldsim.rasterizer.cpu.threads import in_parallel
from hybridworldsim.rasterizer.cpu.tiles import tiles_of
from hybridworldsim.rasterizer.presets import TRANSMITTANCE_STOP, Preset
from hybridworldsim.rasterizer.projected import Projected
from mirror.arrays import Float32, Int32, Int64

_STOP = np.float32(TRANSMITTANCE_STOP)
_HALF = np.float32(0.5)


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
    in_parallel(
        lambda y: _trace_row(
            y,
            tiles_x,
            tiles.begins,
            tiles.ids,
            splats.rows,
            splats.stride,
            preset.alpha_max,
            rows,
            weights,
            number,
            median,
        ),
        height,
    )
    return Traced(*map(torch.from_numpy, (rows, weights, number, median)))


@kernel()
def _trace_row(
    y: int,
    tiles_x: int,
    begins: Int64,
    ids: Int32,
    splats: Float32,
    stride: int,
    alpha_max: float,
    rows: Int64,
    weights: Float32,
    number: Int32,
    median: Int64,
) -> None:
    """Follow the light of a row of pixels."""
    cap = np.float32(alpha_max)
    width, top = rows.shape[1], rows.shape[2]
    for x in range(width):
        light = np.float32(1.0)
        tile = y // TILE_PX * tiles_x + x // TILE_PX
        at_x, at_y = np.float32(x) + _HALF, np.float32(y) + _HALF
        for place in range(begins[tile], begins[tile + 1]):
            row = ids[place] * stride
            dx = (at_x - splats[row + MEAN]) - splats[row + MEAN_LOW]
            dy = (at_y - splats[row + MEAN + 1]) - splats[row + MEAN_LOW + 1]
            u = splats[row + FACTORS] * dx + splats[row + FACTORS + 1] * dy
            v = splats[row + FACTORS + 2] * dy
            exponent = splats[row + LEVEL] - u * u - v * v
            if exponent < FLOOR:
                continue
            weight = light * min(np.exp2(exponent), cap)
            behind = light - weight
            if behind <= _STOP:
                break
            number[y, x] += 1
            if light > _HALF and behind <= _HALF:
                median[y, x] = ids[place]
            light = behind
            # the least of those named gives way; a nearer one stays before an equal
            rank = top
            while rank > 0 and weight > weights[y, x, rank - 1]:
                rank -= 1
                if rank + 1 < top:
                    weights[y, x, rank + 1] = weights[y, x, rank]
                    rows[y, x, rank + 1] = rows[y, x, rank]
            if rank < top:
                weights[y, x, rank], rows[y, x, rank] = weight, ids[place]
