"""Gradients of blending, from the last Gaussian of each tile to the first.

What blending did is computed again: nothing but the light that remains and each pixel's hindmost Gaussian is kept. Each
pair of tile and Gaussian has a line of its own, which `collect` adds up in the order of the lines.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.vectors import (
    beyond,
    bits,
    choose,
    fetch,
    fma,
    least,
    lift,
    load,
    lowest,
    magnitude,
    settle,
    spread,
    store,
    store_past,
    take,
    totals,
)
from hybridworldsim.rasterizer.cpu.blending.canvas import BLOCKS, LANES, PIXELS, TILE_PX
from hybridworldsim.rasterizer.cpu.blending.forward import (
    BATCH,
    BLOCK_X,
    BLOCK_Y,
    PIXEL_X,
    PIXEL_Y,
    PLACED,
    exp2,
    placed,
)
from hybridworldsim.rasterizer.cpu.blending.splats import FEATURES, FLOOR, factors_of
from mirror.arrays import Float32, Float64, Int32, Int64

SUMS: Final = 8
"""Numbers at the head of a line: the sums over pixels of s, s u, s v, s u^2, s u v, s v^2, |s u|, |s (f12 u + f22 v)|,
where s is minus the gradient to half the ellipse's form; the sums of the features' gradients follow."""

_LN4: Final = 2.0 * math.log(2.0)


@kernel(inline="always")
def four(vectors: Float32, first: int) -> Any:
    """Four vectors of many."""
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
    begins: Int64,
    ids: Int32,
    turns: Int32,
    firsts: Int64,
    passed: Int32,
    until: Int64,
    rows: Float32,
    stride: int,
    channels: int,
    tiles_x: int,
    alpha_max: float,
    light: Float32,
    behind: Float32,
    gradient: Float32,
    last: Int32,
    scratch: Float32,
    reached: Int32,
    more: Float32,
    lines: Float32,
    line: int,
    absolute: bool,
) -> None:
    """Gradients of the Gaussians of some tiles.

    Args:
        tiles: which ones.
        begins: where the places of each tile begin.
        ids: the Gaussian at each place.
        turns: how many pairs of the same Gaussian come before each place.
        firsts: (M + 1,) the first line of each Gaussian.
        passed: (T,) how many Gaussians of each tile came before.
        until: (T,) the place in front of which the last Gaussian is that was looked at.
        rows: of the Gaussians.
        stride: of these rows.
        channels: of the features.
        tiles_x: columns of tiles.
        alpha_max: the greatest alpha.
        light: (T * 256,) transmittance behind the last of these Gaussians; in front of the first one afterwards.
        behind: (T * 256,) what the Gaussians behind are worth: the sum of weight times feature times gradient, less the
            light behind all of them times the gradient of alpha; with these Gaussians afterwards.
        gradient: (T * channels * 256,) of the picture.
        last: (T * 256,) the number in its tile of the hindmost Gaussian of a pixel.
        scratch: (BATCH * PLACED,).
        reached: (BATCH,).
        more: ((line - SUMS) * LANES,), zero.
        lines: (pairs * line,) written.
        line: its length.
        absolute: whether the sums without signs are wanted.
    """
    block_x, block_y = load(BLOCK_X, 0), load(BLOCK_Y, 0)
    cap, zero, one = np.float32(alpha_max), spread(np.float32(0.0)), spread(np.float32(1.0))
    for number in range(len(tiles)):
        tile = tiles[number]
        centre_x = np.float32((tile % tiles_x) * TILE_PX + TILE_PX // 2)
        centre_y = np.float32((tile // tiles_x) * TILE_PX + TILE_PX // 2)
        begin, end = begins[tile], until[tile]
        for place in range(end, begins[tile + 1]):
            for column in range(0, line, LANES):
                store_past(lines, (firsts[ids[place]] + turns[place]) * line + column, zero)
        offset = passed[tile] - begin
        for batch in range(begin + (max(end - 1 - begin, 0) // BATCH) * BATCH, begin - 1, -BATCH):
            count = min(BATCH, end - batch)
            open_blocks = 0
            for block in range(BLOCKS):
                if bits(beyond(load(last, tile * PIXELS + block * LANES), np.int32(offset + batch - 1))) != 0:
                    open_blocks |= 1 << block
            for k in range(count):
                fetch(rows, ids[batch + k] * stride)
            for k in range(count):
                row = ids[batch + k] * stride
                reached[k] = open_blocks & placed(rows, row, centre_x, centre_y, scratch, k * PLACED, block_x, block_y)
            for k in range(count - 1, -1, -1):
                place = batch + k
                to_line = (firsts[ids[place]] + turns[place]) * line
                if reached[k] == 0:
                    for column in range(0, line, LANES):
                        store_past(lines, to_line + column, zero)
                    continue
                row, p = ids[place] * stride, k * PLACED
                before = np.int32(offset + place - 1)
                u0, v0, f11, f12 = lift(scratch, p), lift(scratch, p + 1), lift(scratch, p + 2), lift(scratch, p + 3)
                f22, level = lift(scratch, p + 4), lift(scratch, p + 5)
                f0, f1 = lift(rows, row + FEATURES), lift(rows, row + FEATURES + 1)
                f2, f3 = lift(rows, row + FEATURES + 2), lift(rows, row + FEATURES + 3)
                s0, su, sv, suu, suv, svv = zero, zero, zero, zero, zero, zero
                abs_u, abs_v, by0, by1, by2, by3 = zero, zero, zero, zero, zero, zero
                for channel in range(4, channels):
                    store(more, channel * LANES, zero)
                left = np.uint64(reached[k])
                while left != 0:
                    block = lowest(left)
                    left &= left - np.uint64(1)
                    at = tile * PIXELS + block * LANES
                    to = tile * PIXELS * channels + block * LANES
                    x, y = load(PIXEL_X, block * LANES), load(PIXEL_Y, block * LANES)
                    u, v = fma(x, f11, fma(y, f12, u0)), fma(y, f22, v0)
                    exponent = take(u, u, take(v, v, level))
                    inside = (exponent >= FLOOR) & beyond(load(last, at), before)
                    value = exp2(exponent)
                    alpha = choose(inside, least(value, cap), zero)
                    share = one / (one - alpha)
                    through = load(light, at) * share
                    store(light, at, through)
                    weight = alpha * through
                    g0, g1 = load(gradient, to), load(gradient, to + PIXELS)
                    g2, g3 = load(gradient, to + 2 * PIXELS), load(gradient, to + 3 * PIXELS)
                    worth = fma(g0, f0, fma(g1, f1, fma(g2, f2, g3 * f3)))
                    by0, by1, by2, by3 = (
                        fma(weight, g0, by0),
                        fma(weight, g1, by1),
                        fma(weight, g2, by2),
                        fma(weight, g3, by3),
                    )
                    for channel in range(4, channels):
                        here = load(gradient, to + channel * PIXELS)
                        worth = fma(here, lift(rows, row + FEATURES + channel), worth)
                        store(more, channel * LANES, fma(weight, here, load(more, channel * LANES)))
                    rest = load(behind, at)
                    store(behind, at, fma(weight, worth, rest))
                    by_alpha = take(share, rest, through * worth)
                    s = choose(value <= cap, alpha * by_alpha, zero)
                    s0 = s0 + s
                    s_u, s_v = s * u, s * v
                    su, sv = su + s_u, sv + s_v
                    suu, suv, svv = fma(s_u, u, suu), fma(s_u, v, suv), fma(s_v, v, svv)
                    if absolute:
                        abs_u = abs_u + magnitude(s_u)
                        abs_v = abs_v + magnitude(fma(s_u, f12, s_v * f22))
                sums = (s0, su, sv, suu, suv, svv, abs_u, abs_v, by0, by1, by2, by3)
                if channels <= 4:
                    store_past(lines, to_line, totals(sums))
                    continue
                store_past(lines, to_line, totals(sums + four(more, 4)))
                for first in range(LANES - SUMS, line - SUMS, LANES):
                    ones = four(more, first) + four(more, first + 4)
                    others = four(more, first + 8) + four(more, first + 12)
                    store_past(lines, to_line + SUMS + first, totals(ones + others))
    settle()


@kernel()
def collect(
    begin: int,
    end: int,
    firsts: Int64,
    lines: Float32,
    line: int,
    rows: Float32,
    stride: int,
    opacities: Float32,
    means: Float32,
    conics: Float64,
    by_opacity: Float32,
    by_feature: Float32,
    absolute: Float32,
    sums: Float32,
) -> None:
    """Add up the lines of Gaussians, and turn them into gradients.

    Args:
        begin: the first.
        end: the one after the last.
        firsts: (M + 1,) their first lines.
        lines: as written by `blend_tiles_backward`.
        line: their length.
        rows: of the Gaussians.
        stride: of these rows.
        opacities: (M,).
        means: (M, 2) gradient to the means, written, as all that follow.
        conics: (M, 3) to the conics.
        by_opacity: (M,).
        by_feature: (M, D).
        absolute: (M, 2) sums of the magnitudes of each pixel's gradient to the means.
        sums: (line,) scratch.
    """
    channels, none = by_feature.shape[1], spread(np.float32(0.0))
    for i in range(begin, end):
        for column in range(0, line, LANES):
            # each pair's numbers are added with what rounding took from the sum before
            total_so_far, lost = none, none
            for slot in range(firsts[i], firsts[i + 1]):
                added = load(lines, slot * line + column) - lost
                grown = total_so_far + added
                lost = (grown - total_so_far) - added
                total_so_far = grown
            store(sums, column, total_so_far)
        row = i * stride
        f11, f12, f22 = factors_of(rows, row)
        lean = f12 / f22
        suu, suv, svv = np.float64(sums[3]), np.float64(sums[4]), np.float64(sums[5])
        means[i, 0] = _LN4 * f11 * sums[1]
        means[i, 1] = _LN4 * (f12 * sums[1] + f22 * sums[2])
        conics[i, 0] = -0.5 * (suu - 2.0 * lean * suv + lean * lean * svv) / (f11 * f11)
        conics[i, 1] = -(suv - lean * svv) / (f11 * f22)
        conics[i, 2] = -0.5 * svv / (f22 * f22)
        by_opacity[i] = sums[0] / opacities[i] if opacities[i] > 0.0 else 0.0
        absolute[i, 0], absolute[i, 1] = _LN4 * f11 * sums[6], _LN4 * sums[7]
        for channel in range(channels):
            by_feature[i, channel] = sums[SUMS + channel]
