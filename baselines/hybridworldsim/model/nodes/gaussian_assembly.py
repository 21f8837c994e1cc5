"""Compiled kernels, with gradients, that turn the networks' outputs for anchors into Gaussians.

The same in torch is about forty small operations with gathered and scattered copies: half the time of a step.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.dispatch import is_compiled
from hybridworldsim.kernels.memory import empty_aligned, full_aligned
from hybridworldsim.kernels.threads import in_parallel, spans
from hybridworldsim.model.plain import decoding as plain
from mirror.arrays import AnyArray, Float32

GEOMETRY: Final = 8
"""Network outputs of a Gaussian besides its colour: one for opacity, three for scale, four for rotation."""


class AnchorGaussians(NamedTuple):
    """The G Gaussians of anchors that have an opacity above zero.

    Attributes:
        means: (G, 3).
        quats: (G, 4).
        scales: (G, 3).
        opacities: (G,).
        colours: (G, 3).
        slots: (G,) int64 index of each Gaussian: anchor times k plus offset.
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colours: Tensor
    slots: Tensor


def anchors_to_gaussians(
    geometry: Tensor, colours: Tensor, means: Tensor, offsets: Tensor, log_scales: Tensor
) -> AnchorGaussians:
    """Compute the Gaussians of anchors; differentiable with respect to all inputs except the anchors' places.

    Args:
        geometry: (M, k * 8): opacity before tanh; scale before the sigmoid, as a share of the anchor's; rotation.
        colours: (M, k * 3) before the sigmoid.
        means: (M, 3) places of anchors.
        offsets: (M, k, 3) in units of the first three scales.
        log_scales: (M, 6) logarithms of the size of the offsets and of the Gaussians.
    """
    if not is_compiled(geometry):
        return AnchorGaussians(*plain.anchors_to_gaussians(geometry, colours, means, offsets, log_scales))
    return AnchorGaussians(*_AnchorsToGaussians.apply(geometry, colours, means, offsets, log_scales))


def rows_of_slots(slots: Tensor, ids: Tensor, k: int) -> Tensor:
    """Return the rows (G,), among all Gaussians of a node, of slots (G,).

    The slots are those of the anchors ``ids`` (M,).
    """
    if not is_compiled(slots):
        return plain.rows_of_slots(slots, ids, k)
    rows: AnyArray = empty_aligned(len(slots), np.int64)
    write_rows(slots.numpy(), ids.numpy(), k, rows)
    return torch.from_numpy(rows)


@kernel()
def write_rows(slots: Any, ids: Any, k: Any, rows: Any) -> None:
    """Write the rows of slots among all Gaussians of a node; see `rows_of_slots`."""
    for place in range(len(slots)):
        slot = np.uint64(slots[place])
        anchor = slot // np.uint64(k)
        rows[place] = ids[anchor] * k + np.int64(slot - anchor * np.uint64(k))


@kernel()
def count_opaque(geometry: Any, begin: Any, end: Any) -> Any:
    """Count the Gaussians of anchors in a range that have an opacity above zero."""
    count = 0
    for anchor in range(begin, end):
        for place in range(0, geometry.shape[1], GEOMETRY):
            count += geometry[anchor, place] > 0.0
    return count


@kernel()
def write_gaussians(
    geometry: Any, colours: Any, anchors: Any, offsets: Any, log_scales: Any, begin: Any, end: Any,
    first: Any, sizes: Any, means: Any, quats: Any, shares: Any, opacities: Any, tints: Any, slots: Any,
) -> None:  # fmt: skip
    """Write the Gaussians of anchors in a range, from row `first` on; tanh and sigmoid are applied later.

    `sizes` (M, 6) receives the sizes in metres of anchors that have Gaussians, `slots` receives anchor times k plus
    offset.
    """
    k, place = offsets.shape[1], first
    for anchor in range(begin, end):
        begun = place
        for offset in range(k):
            column = GEOMETRY * offset
            if not geometry[anchor, column] > 0.0:
                continue
            if place == begun:
                for axis in range(6):
                    sizes[anchor, axis] = math.exp(log_scales[anchor, axis])
            opacities[place] = geometry[anchor, column]
            for axis in range(3):
                means[place, axis] = anchors[anchor, axis] + offsets[anchor, offset, axis] * sizes[anchor, axis]
                shares[place, axis] = geometry[anchor, column + 1 + axis]
                tints[place, axis] = colours[anchor, 3 * offset + axis]
            for part in range(4):
                quats[place, part] = geometry[anchor, column + 4 + part]
            slots[place] = anchor * k + offset
            place += 1


@kernel()
def write_scales(begin: Any, end: Any, k: Any, slots: Any, sizes: Any, shares: Any, scales: Any) -> None:
    """Write the scales of Gaussians in a range: a share of their anchor's size."""
    for place in range(begin, end):
        anchor = slots[place] // k
        for axis in range(3):
            scales[place, axis] = sizes[anchor, 3 + axis] * shares[place, axis]


@kernel()
def write_gradients(
    offsets: Any, sizes: Any, shares: Any, opacities: Any, tints: Any, slots: Any, begin: Any, end: Any,
    grad_means: Any, grad_quats: Any, grad_scales: Any, grad_opacities: Any, grad_tints: Any,
    grad_geometry: Any, grad_colours: Any, grad_offsets: Any, grad_log_scales: Any,
) -> None:  # fmt: skip
    """Write the gradients of Gaussians in a range into zeroed arrays; the Gaussians of an anchor lie in one range."""
    k, one = offsets.shape[1], np.float32(1.0)
    for place in range(begin, end):
        anchor, offset = slots[place] // k, slots[place] % k
        column = GEOMETRY * offset
        opacity = opacities[place]
        grad_geometry[anchor, column] = grad_opacities[place] * (one - opacity * opacity)
        for axis in range(3):
            share, tint = shares[place, axis], tints[place, axis]
            grad_offset = grad_means[place, axis] * sizes[anchor, axis]
            grad_log_scale = grad_scales[place, axis] * sizes[anchor, 3 + axis] * share
            grad_offsets[anchor, offset, axis] = grad_offset
            grad_log_scales[anchor, axis] += grad_offset * offsets[anchor, offset, axis]
            grad_log_scales[anchor, 3 + axis] += grad_log_scale
            grad_geometry[anchor, column + 1 + axis] = grad_log_scale * (one - share)
            grad_colours[anchor, 3 * offset + axis] = grad_tints[place, axis] * tint * (one - tint)
        for part in range(4):
            grad_geometry[anchor, column + 4 + part] = grad_quats[place, part]


class _AnchorsToGaussians(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, geometry: Tensor, colours: Tensor, means: Tensor, offsets: Tensor, log_scales: Tensor
    ) -> tuple[Tensor, ...]:
        inputs = _array(geometry), _array(colours), _array(means), _array(offsets), _array(log_scales)
        edges, k = spans(len(means)), offsets.shape[1]
        counts = np.zeros(len(edges) - 1, np.int64)

        def count(part: int) -> None:
            counts[part] = count_opaque(inputs[0], edges[part], edges[part + 1])

        in_parallel(count, len(counts))
        firsts = np.concatenate([[0], counts.cumsum()])
        total = int(firsts[-1])
        centres, quats, shares, tints = (_table(total, width) for width in (3, 4, 3, 3))
        opacities, slots = empty_aligned(total), empty_aligned(total, np.int64)
        sizes, scales = _table(len(means), 6), _table(total, 3)

        def fill(part: int) -> None:
            span = edges[part], edges[part + 1], firsts[part]
            write_gaussians(*inputs, *span, sizes, centres, quats, shares, opacities, tints, slots)

        in_parallel(fill, len(counts))
        for numbers in (shares, tints):
            torch.from_numpy(numbers).sigmoid_()
        torch.from_numpy(opacities).tanh_()
        in_parallel(
            lambda part: write_scales(firsts[part], firsts[part + 1], k, slots, sizes, shares, scales), len(counts)
        )
        ctx.read = inputs[3], sizes, shares, opacities, tints, slots
        ctx.firsts, ctx.shapes = firsts, [table.shape for table in (geometry, colours, offsets, log_scales)]
        ids = torch.from_numpy(slots)
        ctx.mark_non_differentiable(ids)
        return (*map(torch.from_numpy, (centres, quats, scales, opacities, tints)), ids)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        output_gradients = [_array(gradient) for gradient in gradients[:5]]
        input_gradients = [full_aligned(shape.numel(), 0.0).reshape(shape) for shape in ctx.shapes]

        def write(part: int) -> None:
            span = ctx.firsts[part], ctx.firsts[part + 1]
            write_gradients(*ctx.read, *span, *output_gradients, *input_gradients)  # type: ignore[call-arg]

        in_parallel(write, len(ctx.firsts) - 1)
        grad_geometry, grad_colours, grad_offsets, grad_log_scales = map(torch.from_numpy, input_gradients)
        return grad_geometry, grad_colours, None, grad_offsets, grad_log_scales


def _table(count: int, width: int) -> Float32:
    table: Float32 = empty_aligned(count * width).reshape(count, width)
    return table


def _array(tensor: Tensor) -> AnyArray:
    return np.ascontiguousarray(tensor.detach().numpy())
