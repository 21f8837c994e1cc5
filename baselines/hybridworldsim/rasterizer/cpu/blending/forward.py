"""Blends the Gaussians of each tile front to back.

A block of 4 x 4 pixels is one vector. Its transmittance and colours stay in registers during the loop over the
Gaussians that reach it. The test which Gaussians reach a block runs for sixteen blocks at once, by a circle around the
block and a circle around the Gaussian, in the space in which the ellipse is a circle.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.vectors import (
    abs_,
    broadcast,
    fma,
    fnma,
    from_bits,
    has_bits,
    load,
    load_one,
    min_or_b,
    prefetch,
    scale_by_power,
    select,
    select_int,
    store,
    to_bits,
    trailing_zeros,
)
from hybridworldsim.rasterizer.cpu.blending.canvas import BLOCKS, LANES, PIXELS, TILE_PX, empty_tile
from hybridworldsim.rasterizer.cpu.blending.splats import (
    FACTORS,
    FEATURES,
    FLOOR,
    LEVEL,
    REACH,
    to_unit_space,
)
from hybridworldsim.rasterizer.cpu.blending.tiles import PREFETCH_DISTANCE
from hybridworldsim.rasterizer.presets import TRANSMITTANCE_STOP
from mirror.arrays import AnyArray, Bool, Float32, Int32, Int64

BATCH: Final = 64
PLACEMENT_SIZE: Final = 6
"""Numbers of a Gaussian placed in a tile: u and v at the centre of the tile, the factors, and the level."""

_LANE: Final = np.arange(LANES, dtype=np.float32)
_BLOCK: Final = np.arange(BLOCKS, dtype=np.float32)[:, None]
PIXEL_X: Final = (4.0 * (_BLOCK % 4) + _LANE % 4 - np.float32(7.5)).astype(np.float32).ravel()
PIXEL_Y: Final = (4.0 * (_BLOCK // 4) + _LANE // 4 - np.float32(7.5)).astype(np.float32).ravel()
"""Offsets of a tile's pixels from its centre, block by block, pixels."""

BLOCK_X: Final = 4 * (_LANE % 4) - np.float32(6.0)
BLOCK_Y: Final = 4 * (_LANE // 4) - np.float32(6.0)
"""Offsets of the blocks' centres from the centre of the tile, pixels."""

_STOP: Final = np.float32(TRANSMITTANCE_STOP)
_EVERY: Final = 0xFFFF
_SHIFT: Final = np.float32(1.5 * 2.0**23)
_E1, _E2, _E3 = np.float32(0.693146944), np.float32(0.240221202), np.float32(0.0555071309)
_E4, _E5 = np.float32(0.00967554096), np.float32(0.00132764713)


@kernel(inline="always")
def exp2(exponent: Any) -> Any:
    """Compute 2 to the power of a vector's elements to 2e-7, from -126 to 126; undefined outside this range."""
    shifted = exponent + _SHIFT
    part = exponent - (shifted - _SHIFT)
    power = fma(fma(fma(broadcast(_E5), part, _E4), part, _E3), part, _E2)
    return scale_by_power(fma(fma(power, part, _E1), part, np.float32(1.0)), shifted)


@kernel(inline="always")
def place_in_tile(
    rows: Float32, row: int, centre_x: Any, centre_y: Any, out: Float32, at: int, block_x: Any, block_y: Any
) -> Any:
    """Write a Gaussian's numbers relative to a tile; return bits of the blocks that the Gaussian may reach."""
    f11, f12, f22 = rows[row + FACTORS], rows[row + FACTORS + 1], rows[row + FACTORS + 2]
    u, v = to_unit_space(rows, row, centre_x, centre_y)
    level = rows[row + LEVEL]
    out[at], out[at + 1], out[at + 2], out[at + 3], out[at + 4], out[at + 5] = u, v, f11, f12, f22, level
    at_x = fma(block_x, f11, fma(block_y, f12, u))
    at_y = fma(block_y, f22, v)
    square = at_y * at_y
    return to_bits((fma(at_x, at_x, square) <= rows[row + REACH]) & (square <= rows[row + REACH + 1]))


@kernel(inline="always")
def group_by_block(block_bits: Int32, gaussian_bits: AnyArray) -> None:
    """Transpose bits: from a mask of blocks for each Gaussian to a mask of Gaussians for each block."""
    for block in range(BLOCKS):
        word, bit = np.uint64(0), np.int32(1 << block)
        for group in range(BATCH // LANES):
            found = has_bits(load(block_bits, group * LANES), bit)
            word |= np.uint64(to_bits(found)) << np.uint64(group * LANES)
        gaussian_bits[block] = word


@kernel()
def blend_tiles(
    tiles: Int64,
    tile_starts: Int64,
    ids: Int32,
    counts_before: Int32,
    rows: Float32,
    stride: int,
    channels: int,
    tiles_x: int,
    width: int,
    height: int,
    alpha_max: float,
    transmittance: Float32,
    colours: Float32,
    last: Int32,
    alive: Bool,
    scratch: Float32,
    block_bits: Int32,
    gaussian_bits: AnyArray,
    processed_end: Int64,
    work: Int64,
) -> None:
    """Blend the Gaussians of some tiles behind the Gaussians of earlier slices.

    Args:
        tiles: indices of the tiles.
        tile_starts: (T + 1,) start of each tile in the list of pairs.
        ids: Gaussian of each pair.
        counts_before: (T,) number of Gaussians of each tile in earlier slices.
        rows: packed rows of the Gaussians.
        stride: length of a row.
        channels: number of feature channels.
        tiles_x: columns of tiles.
        width: width of the image, pixels.
        height: height of the image, pixels.
        alpha_max: upper bound of alpha.
        transmittance: (T * 256,) transmittance of the pixels, block by block; updated; negative if a pixel is done.
        colours: (T * channels * 256,) blended colours; updated.
        last: (T * 256,) index in its tile of the last Gaussian of a pixel; updated.
        alive: (T,) whether at least one pixel of a tile is not done; updated.
        scratch: (BATCH * PLACEMENT_SIZE,) scratch.
        block_bits: (BATCH,) scratch.
        gaussian_bits: (BLOCKS,) scratch.
        processed_end: (T,) one past the last processed pair; written for tiles with pairs.
        work: (2,) numbers of processed pairs, and of processed pairs of block and Gaussian; increased.
    """
    block_x, block_y = load(BLOCK_X, 0), load(BLOCK_Y, 0)
    cap = np.float32(alpha_max)
    for number in range(len(tiles)):
        tile = tiles[number]
        if tile_starts[tile] == tile_starts[tile + 1]:
            continue
        if counts_before[tile] == 0:
            empty_tile(tile, transmittance, colours, last, channels, tiles_x, width, height)
        centre_x = np.float32((tile % tiles_x) * TILE_PX + TILE_PX // 2)
        centre_y = np.float32((tile // tiles_x) * TILE_PX + TILE_PX // 2)
        begin, end = tile_starts[tile], tile_starts[tile + 1]
        offset, processed_end[tile] = counts_before[tile] - begin, begin
        open_blocks, block_pairs = 0, 0
        for block in range(BLOCKS):
            if to_bits(load(transmittance, tile * PIXELS + block * LANES) > np.float32(0.0)) != 0:
                open_blocks |= 1 << block
        for batch in range(begin, end, BATCH):
            if open_blocks == 0:
                break
            count = min(BATCH, end - batch)
            processed_end[tile] = batch + count
            block_bits[:] = 0
            for k in range(count):
                prefetch(rows, ids[batch + k + PREFETCH_DISTANCE] * stride)
                row = ids[batch + k] * stride
                block_bits[k] = place_in_tile(
                    rows, row, centre_x, centre_y, scratch, k * PLACEMENT_SIZE, block_x, block_y
                )
            group_by_block(block_bits, gaussian_bits)
            for block in range(BLOCKS):
                gaussians_left = gaussian_bits[block]
                if (open_blocks >> block) & 1 == 0 or gaussians_left == 0:
                    continue
                at = tile * PIXELS + block * LANES
                x, y = load(PIXEL_X, block * LANES), load(PIXEL_Y, block * LANES)
                in_front = load(transmittance, at)
                active = in_front > np.float32(0.0)
                latest = load(last, at)
                to = tile * PIXELS * channels + block * LANES
                red, green = load(colours, to), load(colours, to + PIXELS)
                blue, other = load(colours, to + 2 * PIXELS), load(colours, to + 3 * PIXELS)
                while gaussians_left != 0:
                    k = trailing_zeros(gaussians_left)
                    gaussians_left &= gaussians_left - np.uint64(1)
                    p = k * PLACEMENT_SIZE
                    block_pairs += 1
                    u = fma(
                        x,
                        load_one(scratch, p + 2),
                        fma(y, load_one(scratch, p + 3), load_one(scratch, p)),
                    )
                    v = fma(y, load_one(scratch, p + 4), load_one(scratch, p + 1))
                    exponent = fnma(u, u, fnma(v, v, load_one(scratch, p + 5)))
                    inside = (exponent >= FLOOR) & active
                    alpha = min_or_b(exp2(exponent), cap)
                    weight = in_front * alpha
                    after = in_front - weight
                    ends = inside & (after <= _STOP)
                    inside = inside & (after > _STOP)
                    weight = select(inside, weight, np.float32(0.0))
                    in_front = select(inside, after, in_front)
                    latest = select_int(inside, np.int32(offset + batch + k), latest)
                    row = ids[batch + k] * stride + FEATURES
                    red, green = (
                        fma(weight, load_one(rows, row), red),
                        fma(weight, load_one(rows, row + 1), green),
                    )
                    blue, other = (
                        fma(weight, load_one(rows, row + 2), blue),
                        fma(weight, load_one(rows, row + 3), other),
                    )
                    for channel in range(4, channels):
                        place = to + channel * PIXELS
                        store(colours, place, fma(weight, load_one(rows, row + channel), load(colours, place)))
                    if to_bits(ends) != 0:
                        active = active & (ends ^ from_bits(_EVERY))
                        if to_bits(active) == 0:
                            open_blocks &= ~(1 << block)
                            break
                store(transmittance, at, select(active, in_front, broadcast(np.float32(0.0)) - abs_(in_front)))
                store(last, at, latest)
                store(colours, to, red)
                store(colours, to + PIXELS, green)
                store(colours, to + 2 * PIXELS, blue)
                store(colours, to + 3 * PIXELS, other)
        work[0] += processed_end[tile] - begin
        work[1] += block_pairs
        alive[tile] = open_blocks != 0
