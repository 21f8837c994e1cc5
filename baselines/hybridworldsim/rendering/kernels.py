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
def _hidden(base: Any, row: Any, shared: Any, steer: Any, x: Any, y: Any, z: Any, width: Any, out: Any) -> None:
    """Write the hidden layer of a row: its own part, what all share, and what the direction adds, cut off at zero."""
    zero = spread(np.float32(0.0))
    for start in range(0, width, WIDTH):
        value = load(base, row * width + start) + load(shared, start)
        value = fma(load(steer, start), x, value)
        value = fma(load(steer, width + start), y, value)
        value = fma(load(steer, 2 * width + start), z, value)
        store(out, start, chosen(value > zero, value, zero))


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _outputs(hidden: Any, first: Any, count: Any, weights: Any, bias: Any, wide: Any, out: Any, to: Any) -> None:
    """Write the last layer, ``bias + weights.T @ hidden``, of so many numbers of the hidden layer."""
    for start in range(0, wide, WIDTH):
        even, odd = load(bias, start), spread(np.float32(0.0))
        for unit in range(0, count, 2):
            even = fma(lift(hidden, first + unit), load(weights, unit * wide + start), even)
            odd = fma(lift(hidden, first + unit + 1), load(weights, (unit + 1) * wide + start), odd)
        store(out, to + start, even + odd)


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
    base: Any,
    shared: Any,
    steer: Any,
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
        base: (N * 2 H,) the anchors' own part of the hidden layers, of geometry and colour.
        shared: (2 H,) what the appearance adds.
        steer: (3 * 2 H,) what the direction adds.
        geometry: (H * G,) last layer, G a multiple of 16.
        geometry_bias: (G,).
        colour: (H * C,), C a multiple of 16.
        colour_bias: (C,).
        scratch: (2 H + G + C,) for its own use.
        places: (M k, 3) gets centres, as do the others what their names say.
        quats: (M k, 4).
        scales: (M k, 3).
        opacities: (M k,).
        colours: (M k, 3).
        ids: (M k,) int64, anchor times k plus offset.

    Returns:
        How many Gaussians.
    """
    both, tall, wide = len(shared), len(geometry_bias), len(colour_bias)
    half, k, count = both // 2, offsets.shape[1], 0
    for place in range(len(rows)):
        row = rows[place]
        x, y, z = _direction(means, row, eye)
        _hidden(base, row, shared, steer, x, y, z, both, scratch)
        _outputs(scratch, 0, half, geometry, geometry_bias, tall, scratch, both)
        any_drawn = False
        for offset in range(k):
            any_drawn |= scratch[both + GEOMETRY * offset] > 0.0
        if not any_drawn:
            continue
        _outputs(scratch, half, half, colour, colour_bias, wide, scratch, both + tall)
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
    base: Any,
    shared: Any,
    steer: Any,
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
        base: (N * H,) their own part of the hidden layer.
        shared: (H,) what the appearance adds.
        steer: (3 * H,) what the direction adds.
        colour: (3 * H,) last layer, a row a channel.
        colour_bias: (3,).
        scratch: (H,) for its own use.
        colours: (M, 3) gets them.
    """
    width = len(shared)
    for place in range(len(rows)):
        row = rows[place]
        x, y, z = _direction(means, row, eye)
        _hidden(base, row, shared, steer, x, y, z, width, scratch)
        for channel in range(3):
            summed = spread(np.float32(0.0))
            for start in range(0, width, WIDTH):
                summed = fma(load(scratch, start), load(colour, channel * width + start), summed)
            colours[place, channel] = _sigmoid(total(summed) + colour_bias[channel])
