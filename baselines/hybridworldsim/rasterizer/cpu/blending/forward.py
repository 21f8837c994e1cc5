"""Blend each tile's Gaussians front to back.

A block of 4 x 4 pixels is one vector. Its light and colours stay in registers
while the Gaussians that reach it pass by; those that do not reach it are sorted out sixteen blocks at once, by circles
round block and ellipse in the space where the ellipse is a circle.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.vectors import (
    bits,
    choose,
    choose_whole,
    fetch,
    fma,
    having,
    least,
    lift,
    load,
    lowest,
    magnitude,
    mask_of,
    spread,
    store,
    take,
    times_power,
)
from hybridworldsim.rasterizer.cpu.blending.canvas import BLOCKS, LANES, PIXELS, TILE_PX
from hybridworldsim.rasterizer.cpu.blending.splats import (
    FACTORS,
    FEATURES,
    FLOOR,
    LEVEL,
    NEAR,
    placed_at,
)
from hybridworldsim.rasterizer.cpu.blending.tiles import AHEAD
from hybridworldsim.rasterizer.presets import TRANSMITTANCE_STOP
from mirror.arrays import AnyArray, Bool, Float32, Int32, Int64

BATCH: Final = 64
PLACED: Final = 6
"""Columns of a Gaussian placed in a tile: u and v at its centre, the factors, the level."""

_LANE: Final = np.arange(LANES, dtype=np.float32)
_BLOCK: Final = np.arange(BLOCKS, dtype=np.float32)[:, None]
PIXEL_X: Final = (4.0 * (_BLOCK % 4) + _LANE % 4 - np.float32(7.5)).astype(np.float32).ravel()
PIXEL_Y: Final = (4.0 * (_BLOCK // 4) + _LANE // 4 - np.float32(7.5)).astype(np.float32).ravel()
"""A tile's pixels, seen from its centre, block by block."""

BLOCK_X: Final = 4 * (_LANE % 4) - np.float32(6.0)
BLOCK_Y: Final = 4 * (_LANE // 4) - np.float32(6.0)
"""The blocks' centres, seen from the tile's."""

_STOP: Final = np.float32(TRANSMITTANCE_STOP)
_EVERY: Final = 0xFFFF
_SHIFT: Final = np.float32(1.5 * 2.0**23)
_E1, _E2, _E3 = np.float32(0.693146944), np.float32(0.240221202), np.float32(0.0555071309)
_E4, _E5 = np.float32(0.00967554096), np.float32(0.00132764713)


@kernel(inline="always")
def exp2(exponent: Any) -> Any:
    """2 to the power of a vector's elements to 2e-7, from -126 to 126; anything beyond."""
    shifted = exponent + _SHIFT
    part = exponent - (shifted - _SHIFT)
    power = fma(fma(fma(spread(_E5), part, _E4), part, _E3), part, _E2)
    return times_power(fma(fma(power, part, _E1), part, np.float32(1.0)), shifted)


@kernel(inline="always")
def placed(
    rows: Float32, row: int, centre_x: Any, centre_y: Any, out: Float32, at: int, block_x: Any, block_y: Any
) -> Any:
    """Place a Gaussian in a tile; which of the tile's blocks it may reach, as bits."""
    f11, f12, f22 = rows[row + FACTORS], rows[row + FACTORS + 1], rows[row + FACTORS + 2]
    u, v = placed_at(rows, row, centre_x, centre_y)
    level = rows[row + LEVEL]
    out[at], out[at + 1], out[at + 2], out[at + 3], out[at + 4], out[at + 5] = u, v, f11, f12, f22, level
    at_x = fma(block_x, f11, fma(block_y, f12, u))
    at_y = fma(block_y, f22, v)
    square = at_y * at_y
    return bits((fma(at_x, at_x, square) <= rows[row + NEAR]) & (square <= rows[row + NEAR + 1]))


@kernel(inline="always")
def by_block(reached: Int32, listed: AnyArray) -> None:
    """From the blocks that each Gaussian reaches, the Gaussians that reach each block: as bits."""
    for block in range(BLOCKS):
        word, bit = np.uint64(0), np.int32(1 << block)
        for group in range(BATCH // LANES):
            found = having(load(reached, group * LANES), bit)
            word |= np.uint64(bits(found)) << np.uint64(group * LANES)
        listed[block] = word


@kernel()
def blend_tiles(
    tiles: Int64,
    begins: Int64,
    ids: Int32,
    passed: Int32,
    rows: Float32,
    stride: int,
    channels: int,
    tiles_x: int,
    alpha_max: float,
    light: Float32,
    colours: Float32,
    last: Int32,
    alive: Bool,
    scratch: Float32,
    reached: Int32,
    listed: AnyArray,
    until: Int64,
    seen: Int64,
) -> None:
    """Blend the Gaussians of some tiles behind what is blended already.

    Args:
        tiles: which ones.
        begins: where the places of each tile begin.
        ids: the Gaussian at each place.
        passed: (T,) how many Gaussians of each tile came before.
        rows: of the Gaussians.
        stride: of these rows.
        channels: of the features.
        tiles_x: columns of tiles.
        alpha_max: the greatest alpha.
        light: (T * 256,) transmittance of the pixels so far, block by block.
        colours: (T * channels * 256,) blended so far.
        last: (T * 256,) the number in its tile of the hindmost Gaussian of a pixel.
        alive: (T,) whether a tile's pixels are not all done; a pixel that is done has negative light.
        scratch: (BATCH * PLACED,).
        reached: (BATCH,).
        listed: (BATCH,).
        until: (T,) written: the place in front of which the last Gaussian that was looked at is.
        seen: (2,) counts Gaussians that were looked at, and pairs of block and Gaussian.
    """
    block_x, block_y = load(BLOCK_X, 0), load(BLOCK_Y, 0)
    cap = np.float32(alpha_max)
    for number in range(len(tiles)):
        tile = tiles[number]
        centre_x = np.float32((tile % tiles_x) * TILE_PX + TILE_PX // 2)
        centre_y = np.float32((tile // tiles_x) * TILE_PX + TILE_PX // 2)
        begin, end = begins[tile], begins[tile + 1]
        offset, until[tile] = passed[tile] - begin, begin
        open_blocks, tried = 0, 0
        for block in range(BLOCKS):
            if bits(load(light, tile * PIXELS + block * LANES) > np.float32(0.0)) != 0:
                open_blocks |= 1 << block
        for batch in range(begin, end, BATCH):
            if open_blocks == 0:
                break
            count = min(BATCH, end - batch)
            until[tile] = batch + count
            reached[:] = 0
            for k in range(count):
                fetch(rows, ids[batch + k + AHEAD] * stride)
                row = ids[batch + k] * stride
                reached[k] = placed(rows, row, centre_x, centre_y, scratch, k * PLACED, block_x, block_y)
            by_block(reached, listed)
            for block in range(BLOCKS):
                left = listed[block]
                if (open_blocks >> block) & 1 == 0 or left == 0:
                    continue
                at = tile * PIXELS + block * LANES
                x, y = load(PIXEL_X, block * LANES), load(PIXEL_Y, block * LANES)
                through = load(light, at)
                alive_here = through > np.float32(0.0)
                latest = load(last, at)
                to = tile * PIXELS * channels + block * LANES
                red, green = load(colours, to), load(colours, to + PIXELS)
                blue, other = load(colours, to + 2 * PIXELS), load(colours, to + 3 * PIXELS)
                while left != 0:
                    k = lowest(left)
                    left &= left - np.uint64(1)
                    p = k * PLACED
                    tried += 1
                    u = fma(x, lift(scratch, p + 2), fma(y, lift(scratch, p + 3), lift(scratch, p)))
                    v = fma(y, lift(scratch, p + 4), lift(scratch, p + 1))
                    exponent = take(u, u, take(v, v, lift(scratch, p + 5)))
                    inside = (exponent >= FLOOR) & alive_here
                    alpha = least(exp2(exponent), cap)
                    weight = through * alpha
                    behind = through - weight
                    ends = inside & (behind <= _STOP)
                    inside = inside & (behind > _STOP)
                    weight = choose(inside, weight, np.float32(0.0))
                    through = choose(inside, behind, through)
                    latest = choose_whole(inside, np.int32(offset + batch + k), latest)
                    row = ids[batch + k] * stride + FEATURES
                    red, green = fma(weight, lift(rows, row), red), fma(weight, lift(rows, row + 1), green)
                    blue, other = fma(weight, lift(rows, row + 2), blue), fma(weight, lift(rows, row + 3), other)
                    for channel in range(4, channels):
                        place = to + channel * PIXELS
                        store(colours, place, fma(weight, lift(rows, row + channel), load(colours, place)))
                    if bits(ends) != 0:
                        alive_here = alive_here & (ends ^ mask_of(_EVERY))
                        if bits(alive_here) == 0:
                            open_blocks &= ~(1 << block)
                            break
                store(light, at, choose(alive_here, through, spread(np.float32(0.0)) - magnitude(through)))
                store(last, at, latest)
                store(colours, to, red)
                store(colours, to + PIXELS, green)
                store(colours, to + 2 * PIXELS, blue)
                store(colours, to + 3 * PIXELS, other)
        seen[0] += until[tile] - begin
        seen[1] += tried
        alive[tile] = open_blocks != 0
