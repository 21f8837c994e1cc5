"""Gradients of blending, from the last Gaussian of each tile to the first.

The forward pass keeps the final transmittance and the last Gaussian of each pixel; the backward pass computes all other
values again. Each pair of tile and Gaussian has its own line of sums. `reduce_lines` adds the lines in their order.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.vectors import (
    abs_,
    broadcast,
    fence,
    fma,
    fnma,
    greater_int,
    load,
    load_one,
    min_or_b,
    prefetch,
    select,
    store,
    store_nontemporal,
    sum_each,
    to_bits,
    trailing_zeros,
)
from hybridworldsim.rasterizer.cpu.blending.canvas import BLOCKS, LANES, PIXELS, TILE_PX
from hybridworldsim.rasterizer.cpu.blending.forward import (
    BATCH,
    BLOCK_X,
    BLOCK_Y,
    PIXEL_X,
    PIXEL_Y,
    PLACEMENT_SIZE,
    exp2,
    place_in_tile,
)
from hybridworldsim.rasterizer.cpu.blending.splats import FEATURES, FLOOR, load_factors
from mirror.arrays import Float32, Float64, Int32, Int64

SUMS: Final = 8
"""Numbers at the start of a line: the sums over pixels of s, s u, s v, s u^2, s u v, s v^2, |s u|, |s (f12 u + f22 v)|,
where -s is the gradient to half the ellipse's form. The sums of the features' gradients follow."""

_LN4: Final = 2.0 * math.log(2.0)


@kernel(inline="always")
def load_four(vectors: Float32, first: int) -> Any:
    """Load four consecutive vectors."""
    at = first * LANES
    return (
        load(vectors, at),
        load(vectors, at + LANES),
        load(vectors, at + 2 * LANES),
        load(vectors, at + 3 * LANES),
    )


@kernel()
def blend_tiles_backward(
    tiles: Int64,
    tile_starts: Int64,
    ids: Int32,
    pair_ranks: Int32,
    first_lines: Int64,
    counts_before: Int32,
    processed_end: Int64,
    rows: Float32,
    stride: int,
    channels: int,
    tiles_x: int,
    alpha_max: float,
    transmittance: Float32,
    background_sum: Float32,
    grad_colours: Float32,
    last: Int32,
    scratch: Float32,
    block_bits: Int32,
    extra_sums: Float32,
    lines: Float32,
    line_size: int,
    absgrad: bool,
) -> None:
    """Compute the gradients of the Gaussians of some tiles.

    Args:
        tiles: indices of the tiles.
        tile_starts: (T + 1,) start of each tile in the list of pairs.
        ids: Gaussian of each pair.
        pair_ranks: number of earlier pairs of the same Gaussian, for each pair.
        first_lines: (M + 1,) first line of each Gaussian.
        counts_before: (T,) number of Gaussians of each tile in earlier slices.
        processed_end: (T,) one past the last processed pair of each tile.
        rows: packed rows of the Gaussians.
        stride: length of a row.
        channels: number of feature channels.
        tiles_x: columns of tiles.
        alpha_max: upper bound of alpha.
        transmittance: (T * 256,) on entry behind the last of these Gaussians, on return in front of the first.
        background_sum: (T * 256,) on entry the sum over the Gaussians behind these of weight * feature * gradient,
            minus the final transmittance * gradient of alpha; on return these Gaussians are included.
        grad_colours: (T * channels * 256,) gradient to the image, in blocks.
        last: (T * 256,) index in its tile of the last Gaussian of a pixel.
        scratch: (BATCH * PLACEMENT_SIZE,) scratch.
        block_bits: (BATCH,) scratch.
        extra_sums: ((line_size - SUMS) * LANES,) scratch, zero on entry.
        lines: (pairs * line_size,) output.
        line_size: length of a line.
        absgrad: whether to compute the sums of absolute values.
    """
    block_x, block_y = load(BLOCK_X, 0), load(BLOCK_Y, 0)
    cap, zero, one = np.float32(alpha_max), broadcast(np.float32(0.0)), broadcast(np.float32(1.0))
    for number in range(len(tiles)):
        tile = tiles[number]
        centre_x = np.float32((tile % tiles_x) * TILE_PX + TILE_PX // 2)
        centre_y = np.float32((tile // tiles_x) * TILE_PX + TILE_PX // 2)
        begin, end = tile_starts[tile], processed_end[tile]
        for place in range(end, tile_starts[tile + 1]):
            for column in range(0, line_size, LANES):
                store_nontemporal(lines, (first_lines[ids[place]] + pair_ranks[place]) * line_size + column, zero)
        offset = counts_before[tile] - begin
        for batch in range(begin + (max(end - 1 - begin, 0) // BATCH) * BATCH, begin - 1, -BATCH):
            count = min(BATCH, end - batch)
            open_blocks = 0
            for block in range(BLOCKS):
                if to_bits(greater_int(load(last, tile * PIXELS + block * LANES), np.int32(offset + batch - 1))) != 0:
                    open_blocks |= 1 << block
            for k in range(count):
                prefetch(rows, ids[batch + k] * stride)
            for k in range(count):
                row = ids[batch + k] * stride
                block_bits[k] = open_blocks & place_in_tile(
                    rows, row, centre_x, centre_y, scratch, k * PLACEMENT_SIZE, block_x, block_y
                )
            for k in range(count - 1, -1, -1):
                place = batch + k
                to_line = (first_lines[ids[place]] + pair_ranks[place]) * line_size
                if block_bits[k] == 0:
                    for column in range(0, line_size, LANES):
                        store_nontemporal(lines, to_line + column, zero)
                    continue
                row, p = ids[place] * stride, k * PLACEMENT_SIZE
                before = np.int32(offset + place - 1)
                u0, v0, f11, f12 = (
                    load_one(scratch, p),
                    load_one(scratch, p + 1),
                    load_one(scratch, p + 2),
                    load_one(scratch, p + 3),
                )
                f22, level = load_one(scratch, p + 4), load_one(scratch, p + 5)
                f0, f1 = load_one(rows, row + FEATURES), load_one(rows, row + FEATURES + 1)
                f2, f3 = load_one(rows, row + FEATURES + 2), load_one(rows, row + FEATURES + 3)
                s0, su, sv, suu, suv, svv = zero, zero, zero, zero, zero, zero
                abs_u, abs_v, grad_f0, grad_f1, grad_f2, grad_f3 = zero, zero, zero, zero, zero, zero
                for channel in range(4, channels):
                    store(extra_sums, channel * LANES, zero)
                blocks_left = np.uint64(block_bits[k])
                while blocks_left != 0:
                    block = trailing_zeros(blocks_left)
                    blocks_left &= blocks_left - np.uint64(1)
                    at = tile * PIXELS + block * LANES
                    to = tile * PIXELS * channels + block * LANES
                    x, y = load(PIXEL_X, block * LANES), load(PIXEL_Y, block * LANES)
                    u, v = fma(x, f11, fma(y, f12, u0)), fma(y, f22, v0)
                    exponent = fnma(u, u, fnma(v, v, level))
                    inside = (exponent >= FLOOR) & greater_int(load(last, at), before)
                    value = exp2(exponent)
                    alpha = select(inside, min_or_b(value, cap), zero)
                    share = one / (one - alpha)
                    in_front = load(transmittance, at) * share
                    store(transmittance, at, in_front)
                    weight = alpha * in_front
                    g0, g1 = load(grad_colours, to), load(grad_colours, to + PIXELS)
                    g2, g3 = load(grad_colours, to + 2 * PIXELS), load(grad_colours, to + 3 * PIXELS)
                    grad_weight = fma(g0, f0, fma(g1, f1, fma(g2, f2, g3 * f3)))
                    grad_f0, grad_f1, grad_f2, grad_f3 = (
                        fma(weight, g0, grad_f0),
                        fma(weight, g1, grad_f1),
                        fma(weight, g2, grad_f2),
                        fma(weight, g3, grad_f3),
                    )
                    for channel in range(4, channels):
                        grad_colour = load(grad_colours, to + channel * PIXELS)
                        grad_weight = fma(grad_colour, load_one(rows, row + FEATURES + channel), grad_weight)
                        store(extra_sums, channel * LANES, fma(weight, grad_colour, load(extra_sums, channel * LANES)))
                    rest = load(background_sum, at)
                    store(background_sum, at, fma(weight, grad_weight, rest))
                    grad_alpha = fnma(share, rest, in_front * grad_weight)
                    s = select(value <= cap, alpha * grad_alpha, zero)
                    s0 = s0 + s
                    s_u, s_v = s * u, s * v
                    su, sv = su + s_u, sv + s_v
                    suu, suv, svv = fma(s_u, u, suu), fma(s_u, v, suv), fma(s_v, v, svv)
                    if absgrad:
                        abs_u = abs_u + abs_(s_u)
                        abs_v = abs_v + abs_(fma(s_u, f12, s_v * f22))
                sums = (s0, su, sv, suu, suv, svv, abs_u, abs_v, grad_f0, grad_f1, grad_f2, grad_f3)
                if channels <= 4:
                    store_nontemporal(lines, to_line, sum_each(sums))
                    continue
                store_nontemporal(lines, to_line, sum_each(sums + load_four(extra_sums, 4)))
                for first in range(LANES - SUMS, line_size - SUMS, LANES):
                    ones = load_four(extra_sums, first) + load_four(extra_sums, first + 4)
                    others = load_four(extra_sums, first + 8) + load_four(extra_sums, first + 12)
                    store_nontemporal(lines, to_line + SUMS + first, sum_each(ones + others))
    fence()


@kernel()
def reduce_lines(
    begin: int,
    end: int,
    first_lines: Int64,
    lines: Float32,
    line_size: int,
    rows: Float32,
    stride: int,
    opacities: Float32,
    grad_means2d: Float32,
    grad_conics: Float64,
    grad_opacities: Float32,
    grad_features: Float32,
    absgrad: Float32,
    sums: Float32,
) -> None:
    """Sum the gradient lines of each Gaussian over tiles, and convert the sums to gradients.

    Args:
        begin: first Gaussian.
        end: one past the last.
        first_lines: (M + 1,) first line of each Gaussian.
        lines: lines written by `blend_tiles_backward`.
        line_size: length of a line.
        rows: packed rows of the Gaussians.
        stride: length of a row.
        opacities: (M,).
        grad_means2d: (M, 2) output, gradient to the means.
        grad_conics: (M, 3) output, gradient to the conics.
        grad_opacities: (M,) output, gradient to the opacities.
        grad_features: (M, D) output, gradient to the features.
        absgrad: (M, 2) output, sums of the absolute gradients of each pixel to the means.
        sums: (line_size,) scratch.
    """
    channels, none = grad_features.shape[1], broadcast(np.float32(0.0))
    for i in range(begin, end):
        for column in range(0, line_size, LANES):
            # compensated (Kahan) summation: the rounding error of each sum is subtracted from the next addend
            total_so_far, lost = none, none
            for slot in range(first_lines[i], first_lines[i + 1]):
                added = load(lines, slot * line_size + column) - lost
                grown = total_so_far + added
                lost = (grown - total_so_far) - added
                total_so_far = grown
            store(sums, column, total_so_far)
        row = i * stride
        f11, f12, f22 = load_factors(rows, row)
        shear = f12 / f22
        suu, suv, svv = np.float64(sums[3]), np.float64(sums[4]), np.float64(sums[5])
        grad_means2d[i, 0] = _LN4 * f11 * sums[1]
        grad_means2d[i, 1] = _LN4 * (f12 * sums[1] + f22 * sums[2])
        grad_conics[i, 0] = -0.5 * (suu - 2.0 * shear * suv + shear * shear * svv) / (f11 * f11)
        grad_conics[i, 1] = -(suv - shear * svv) / (f11 * f22)
        grad_conics[i, 2] = -0.5 * svv / (f22 * f22)
        grad_opacities[i] = sums[0] / opacities[i] if opacities[i] > 0.0 else 0.0
        absgrad[i, 0], absgrad[i, 1] = _LN4 * f11 * sums[6], _LN4 * sums[7]
        for channel in range(channels):
            grad_features[i, channel] = sums[SUMS + channel]
