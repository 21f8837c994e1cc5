"""The networks of nodes without gradients: a compiled kernel computes all layers of four rows at once.

As matrix products, the inputs and the hidden layer of all rows are written to memory and read again, and the last layer
is too narrow for a fast product.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.memory import empty_aligned, full_aligned
from hybridworldsim.kernels.threads import in_parallel, spans
from hybridworldsim.kernels.vectors import WIDTH, broadcast, fma, load, load_one, select, store
from hybridworldsim.model.decoders import ModulatedMLP
from mirror.arrays import AnyArray, Float32

_ROWS: Final = 4
_BLOCK: Final = 2 * WIDTH
"""Numbers of the hidden layer that are computed at once."""


def run_fused(
    codes: Tensor, means: Tensor, eye: Tensor, radius_m: float | None, *networks: tuple[ModulatedMLP, Tensor]
) -> tuple[Tensor, ...]:
    """Run several networks as `run_networks` does, without gradients.

    The result of a row does not depend on the other rows.
    """
    tables = _array(codes), _array(means), _array(eye)
    inverse_radius = np.float32(0.0 if radius_m is None else 1.0 / radius_m)
    return tuple(
        torch.from_numpy(_run(*tables, inverse_radius, *_layers(network, latent))) for network, latent in networks
    )


def _run(
    codes: Float32,
    means: Float32,
    eye: Float32,
    inverse_radius: np.float32,
    first: Float32,
    last: Float32,
    outputs: int,
) -> Float32:
    out: Float32 = empty_aligned(len(codes) * outputs).reshape(len(codes), outputs)
    edges = spans(len(codes))

    def work(part: int) -> None:
        inputs, hidden, results = (empty_aligned(_ROWS * layer.shape[-1]) for layer in (first.T, first, last))
        run_network(
            edges[part], edges[part + 1], codes, means, eye, inverse_radius,
            first.ravel(), last.ravel(), inputs, hidden, results, out,
        )  # fmt: skip

    in_parallel(work, len(edges) - 1)
    return out


def _layers(network: ModulatedMLP, latent: Tensor) -> tuple[Float32, Float32, int]:
    """The layers of a network under an appearance, and its number of outputs.

    Each layer is transposed, its bias is the last row, and zeros fill its columns: the first layer has a multiple of
    `_BLOCK`, the last a multiple of `WIDTH`, and zeros fill its rows where the first layer has more columns.
    """
    first = network.first_layer(latent, network.own.shape[1] + 1).detach().numpy().T
    weight, bias = network.out.weight.detach().numpy(), network.out.bias.detach().numpy()
    (inputs, width), outputs = first.shape, len(weight)
    hidden = width + -width % _BLOCK
    padded = full_aligned(inputs * hidden, 0.0).reshape(inputs, hidden)
    padded[:, :width] = first
    columns = outputs + -outputs % WIDTH
    last = full_aligned((hidden + 1) * columns, 0.0).reshape(hidden + 1, columns)
    last[:width, :outputs], last[hidden, :outputs] = weight.T, bias
    return padded, last, outputs


@kernel()
def run_network(
    begin: Any, end: Any, codes: Any, means: Any, eye: Any, inverse_radius: Any,
    first: Any, last: Any, inputs: Any, hidden: Any, results: Any, out: Any,
) -> None:  # fmt: skip
    """Apply a network to the rows in a range.

    Args:
        begin: first row.
        end: one past the last row.
        codes: (M, F) float32.
        means: (M, 3) float32.
        eye: (3,) float32.
        inverse_radius: unit of the places; 0: the network reads no places.
        first: flat (inputs + 1, H) the first layer, with the bias as last row; H is a multiple of `_BLOCK`.
        last: flat (H + 1, C) the last layer, with the bias as last row; C is a multiple of `WIDTH`.
        inputs: memory of `_ROWS` times inputs + 1.
        hidden: memory of `_ROWS` times H.
        results: memory of `_ROWS` times C.
        out: (M, outputs) receives the outputs.
    """
    size, outputs = codes.shape[1], out.shape[1]
    width, columns = len(hidden) // _ROWS, len(results) // _ROWS
    count = len(first) // width - 1
    zero = broadcast(np.float32(0.0))
    for place in range(begin, end, _ROWS):
        rows = min(_ROWS, end - place)
        for lane in range(_ROWS):
            row = place + min(lane, rows - 1)
            for number in range(size):
                inputs[_ROWS * number + lane] = codes[row, number]
            x, y, z = means[row, 0] - eye[0], means[row, 1] - eye[1], means[row, 2] - eye[2]
            length = np.float32(1.0) / np.float32(math.sqrt(max(x * x + y * y + z * z, np.float32(1e-24))))
            beside = _ROWS * size + lane
            inputs[beside], inputs[beside + _ROWS], inputs[beside + 2 * _ROWS] = x * length, y * length, z * length
            if inverse_radius > 0.0:
                for axis in range(3):
                    inputs[beside + (3 + axis) * _ROWS] = means[row, axis] * inverse_radius
        for block in range(0, width, _BLOCK):
            a0, a1 = load(first, count * width + block), load(first, count * width + block + WIDTH)
            b0, b1, c0, c1, d0, d1 = a0, a1, a0, a1, a0, a1
            for number in range(count):
                low, high = load(first, number * width + block), load(first, number * width + block + WIDTH)
                a, b = load_one(inputs, _ROWS * number), load_one(inputs, _ROWS * number + 1)
                c, d = load_one(inputs, _ROWS * number + 2), load_one(inputs, _ROWS * number + 3)
                a0, b0, c0, d0 = fma(a, low, a0), fma(b, low, b0), fma(c, low, c0), fma(d, low, d0)
                a1, b1, c1, d1 = fma(a, high, a1), fma(b, high, b1), fma(c, high, c1), fma(d, high, d1)
            for lane, low, high in ((0, a0, a1), (1, b0, b1), (2, c0, c1), (3, d0, d1)):
                # A number that is not finite stays so, and its Gaussians are not drawn.
                store(hidden, lane * width + block, select(low < 0.0, zero, low))
                store(hidden, lane * width + block + WIDTH, select(high < 0.0, zero, high))
        for column in range(0, columns, WIDTH):
            # Even and odd rows of the layer are summed apart, because an addition waits for the one before it.
            a0 = load(last, width * columns + column)
            b0, c0, d0, a1, b1, c1, d1 = a0, a0, a0, zero, zero, zero, zero
            for number in range(0, width, 2):
                even, odd = load(last, number * columns + column), load(last, (number + 1) * columns + column)
                a0, a1 = fma(load_one(hidden, number), even, a0), fma(load_one(hidden, number + 1), odd, a1)
                number += width
                b0, b1 = fma(load_one(hidden, number), even, b0), fma(load_one(hidden, number + 1), odd, b1)
                number += width
                c0, c1 = fma(load_one(hidden, number), even, c0), fma(load_one(hidden, number + 1), odd, c1)
                number += width
                d0, d1 = fma(load_one(hidden, number), even, d0), fma(load_one(hidden, number + 1), odd, d1)
            for lane, even, odd in ((0, a0, a1), (1, b0, b1), (2, c0, c1), (3, d0, d1)):
                store(results, lane * columns + column, even + odd)
        for lane in range(rows):
            for number in range(outputs):
                out[place + lane, number] = results[lane * columns + number]


def _array(tensor: Tensor) -> AnyArray:
    return np.ascontiguousarray(tensor.detach().numpy())
