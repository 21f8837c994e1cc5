"""Compiled kernels that decode what a viewpoint sees, one anchor after the other: nothing in between is stored."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from hybridworldsim.rasterizer.cpu.machine.vectors import WIDTH, fma, lift, load, spread, store, total
from hybridworldsim.rasterizer.cpu.machine.vectors import choose as chosen
from hybridworldsim.scene.nodes.assembly import GEOMETRY


@numba.njit(cache=True, nogil=True, error_model="numpy")
def rows_seen(begin: Any, end: Any, means: Any, reach: Any, view: Any, rows: Any) -> Any:
    """Find the rows whose sphere a view's pyramid may meet, as `hybridworldsim.scene.visible` does.

    Args:
        begin: first row.
        end: past the last.
        means: (N, 3) float32.
        reach: (N,) float32.
        view: (21,) float32: rotation by rows, translation; nearest depth; of either axis the low and high slopes of its
            planes and, of all four, the lengths of their normals follow.
        rows: (N,) int64 gets them, from `begin` on.

    Returns:
        How many.
    """
    count = 0
    for row in range(begin, end):
        x, y, z = means[row, 0], means[row, 1], means[row, 2]
        depth = view[6] * x + view[7] * y + view[8] * z + view[11]
        r = reach[row]
        if not depth + r > view[12]:
            continue
        across = view[0] * x + view[1] * y + view[2] * z + view[9]
        down = view[3] * x + view[4] * y + view[5] * z + view[10]
        if (
            across + view[13] * depth > -r * view[17]
            and view[14] * depth - across > -r * view[18]
            and down + view[15] * depth > -r * view[19]
            and view[16] * depth - down > -r * view[20]
        ):
            rows[begin + count] = row
            count += 1
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _layer(values: Any, first: Any, count: Any, weights: Any, bias: Any, out: Any, to: Any) -> None:
    """Write a layer, ``bias + weights.T @ values``, of an even number of values that begin at `first`."""
    wide = len(bias)
    for start in range(0, wide, WIDTH):
        even, odd = load(bias, start), spread(np.float32(0.0))
        for unit in range(0, count, 2):
            even = fma(lift(values, first + unit), load(weights, unit * wide + start), even)
            odd = fma(lift(values, first + unit + 1), load(weights, (unit + 1) * wide + start), odd)
        store(out, to + start, even + odd)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _cut(values: Any, first: Any, count: Any) -> None:
    """Cut values off at zero."""
    zero = spread(np.float32(0.0))
    for start in range(first, first + count, WIDTH):
        value = load(values, start)
        store(values, start, chosen(value > zero, value, zero))


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _direction(means: Any, row: Any, eye: Any) -> Any:
    x, y, z = means[row, 0] - eye[0], means[row, 1] - eye[1], means[row, 2] - eye[2]
    length = max(np.float32(math.sqrt(x * x + y * y + z * z)), np.float32(1e-12))
    return x / length, y / length, z / length


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sigmoid(number: Any) -> Any:
    return np.float32(1.0) / (np.float32(1.0) + np.float32(math.exp(-number)))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def decode_anchors(
    rows: Any,
    eye: Any,
    means: Any,
    offsets: Any,
    sizes: Any,
    codes: Any,
    radius: Any,
    first: Any,
    first_bias: Any,
    geometry: Any,
    geometry_bias: Any,
    colour: Any,
    colour_bias: Any,
    scratch: Any,
    places: Any,
    quats: Any,
    scales: Any,
    opacities: Any,
    colours: Any,
    ids: Any,
) -> Any:
    """Decode the Gaussians of anchors; those of no opacity are left out.

    Args:
        rows: (M,) int64 anchors.
        eye: (3,) camera.
        means: (N, 3) anchors.
        offsets: (N, k, 3).
        sizes: (N, 6) of offsets and Gaussians, metres.
        codes: (N, F).
        radius: of the block.
        first: (D * 2 H,) first layers of geometry and colour, of F + 6 numbers, D of them with the padding, an even
            number.
        first_bias: (2 H,), H a multiple of 16.
        geometry: (H * G,) last layer, G a multiple of 16.
        geometry_bias: (G,).
        colour: (H * C,), C a multiple of 16.
        colour_bias: (C,).
        scratch: (2 H + G + C + D,) of zeros, for its own use.
        places: (M k, 3) gets centres, as do the others what their names say.
        quats: (M k, 4).
        scales: (M k, 3).
        opacities: (M k,).
        colours: (M k, 3).
        ids: (M k,) int64, anchor times k plus offset.

    Returns:
        How many Gaussians.
    """
    both, tall, wide, size = len(first_bias), len(geometry_bias), len(colour_bias), codes.shape[1]
    half, k, count = both // 2, offsets.shape[1], 0
    given, deep = both + tall + wide, len(first) // both
    for place in range(len(rows)):
        row = rows[place]
        for number in range(size):
            scratch[given + number] = codes[row, number]
        direction = _direction(means, row, eye)
        for axis in range(3):
            scratch[given + size + axis] = direction[axis]
            scratch[given + size + 3 + axis] = means[row, axis] / radius
        _layer(scratch, given, deep, first, first_bias, scratch, 0)
        _cut(scratch, 0, both)
        _layer(scratch, 0, half, geometry, geometry_bias, scratch, both)
        any_drawn = False
        for offset in range(k):
            any_drawn |= scratch[both + GEOMETRY * offset] > 0.0
        if not any_drawn:
            continue
        _layer(scratch, half, half, colour, colour_bias, scratch, both + tall)
        for offset in range(k):
            own = both + GEOMETRY * offset
            if not scratch[own] > 0.0:
                continue
            opacity = np.float32(math.tanh(scratch[own]))
            tint = both + tall + 3 * offset
            for axis in range(3):
                places[count, axis] = means[row, axis] + offsets[row, offset, axis] * sizes[row, axis]
                scales[count, axis] = sizes[row, 3 + axis] * _sigmoid(scratch[own + 1 + axis])
                colours[count, axis] = _sigmoid(scratch[tint + axis])
            for part in range(4):
                quats[count, part] = scratch[own + 4 + part]
            opacities[count] = opacity
            ids[count] = row * k + offset
            count += 1
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy")
def decode_colours(
    rows: Any,
    eye: Any,
    means: Any,
    codes: Any,
    first: Any,
    first_bias: Any,
    colour: Any,
    colour_bias: Any,
    scratch: Any,
    colours: Any,
) -> None:
    """Colours of Code-Gaussians.

    Args:
        rows: (M,) int64.
        eye: (3,) camera.
        means: (N, 3).
        codes: (N, F).
        first: (D * H,) first layer, of F + 3 numbers, D of them with the padding, an even number.
        first_bias: (H,), H a multiple of 16.
        colour: (3 * H,) last layer, a row a channel.
        colour_bias: (3,).
        scratch: (H + D,) of zeros, for its own use.
        colours: (M, 3) gets them.
    """
    width, size = len(first_bias), codes.shape[1]
    deep = len(first) // width
    for place in range(len(rows)):
        row = rows[place]
        for number in range(size):
            scratch[width + number] = codes[row, number]
        direction = _direction(means, row, eye)
        for axis in range(3):
            scratch[width + size + axis] = direction[axis]
        _layer(scratch, width, deep, first, first_bias, scratch, 0)
        _cut(scratch, 0, width)
        for channel in range(3):
            summed = spread(np.float32(0.0))
            for start in range(0, width, WIDTH):
                summed = fma(load(scratch, start), load(colour, channel * width + start), summed)
            colours[place, channel] = _sigmoid(total(summed) + colour_bias[channel])
