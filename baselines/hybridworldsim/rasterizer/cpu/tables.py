"""Takes and scatters rows of float32 tables by compiled kernels, because torch's busy-waiting threads slow them."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.memory import empty_aligned
from hybridworldsim.kernels.threads import in_parallel, spans
from mirror.arrays import Float32, Float64, Int64

_FEW: Final = 4096
"""Fewer numbers than these are added at once: threads would take longer to start."""


class _TakeRows(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, table: Tensor, ids: Tensor, column: Tensor | None) -> Tensor:
        ctx.save_for_backward(ids)
        ctx.shape, ctx.appended = table.shape, column is not None
        flat, numbers = _flat(table), ids.numpy()
        appended = np.empty(0, np.float32) if column is None else _flat(column)[:, 0]
        width = flat.shape[1] + ctx.appended
        out = empty_aligned(len(numbers) * width).reshape(len(numbers), width)
        edges = spans(len(numbers))
        in_parallel(lambda part: _gather(edges[part], edges[part + 1], flat, numbers, appended, out), len(edges) - 1)
        return torch.from_numpy(out if ctx.appended else out.reshape(len(numbers), *table.shape[1:]))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        (ids,) = ctx.saved_tensors
        gradient, numbers = _flat(gradients[0]), ids.numpy()
        out = scatter_rows(gradient, numbers, ctx.shape)
        column = torch.from_numpy(gradient[:, -1].copy()) if ctx.appended and ctx.needs_input_grad[2] else None
        return torch.from_numpy(out), None, column


def take_rows(table: Tensor, ids: Tensor, column: Tensor | None = None) -> Tensor:
    """Take rows of a table, and append a column.

    Args:
        table: (N, ...) float32 on the CPU; (N, D) if there is a column.
        ids: (M,) int64, ascending, unique.
        column: (M,) float32, or None.

    Returns:
        (M, ...), or (M, D + 1).
    """
    taken: Tensor = _TakeRows.apply(table, ids, column)
    return taken


def scatter_rows(part: Float32, ids: Int64, shape: torch.Size) -> Float32:
    """Scatter rows into a table of zeros.

    Args:
        part: (M, D); only the first columns are used if the rows of the table are narrower.
        ids: (M,) row indices in the table, ascending, unique.
        shape: shape of the table, (N, ...).
    """
    out: Float32 = empty_aligned(shape.numel()).reshape(shape)
    flat, edges = out.reshape(shape[0], shape[1:].numel()), spans(len(ids))
    in_parallel(lambda span: _scatter(edges[span], edges[span + 1], part, ids, flat), len(edges) - 1)
    return out


def sum_table(table: Tensor) -> float:
    """Sum a float32 table in float64; the last digits depend on the number of threads."""
    numbers = table.detach().contiguous().numpy().reshape(-1)
    if len(numbers) < _FEW:
        return float(numbers.sum(dtype=np.float64))
    edges = spans(len(numbers))
    sums = np.zeros(len(edges) - 1)
    in_parallel(lambda part: _add(edges[part], edges[part + 1], numbers, sums[part : part + 1]), len(sums))
    return float(sums.sum())


def _flat(table: Tensor) -> Float32:
    """View a table as (N, D)."""
    numbers: Float32 = table.detach().contiguous().numpy()
    return numbers.reshape(len(numbers), int(np.prod(numbers.shape[1:])))


@kernel()
def _gather(begin: int, end: int, table: Float32, ids: Int64, column: Float32, out: Float32) -> None:
    """Copy rows of a table, and a column if it is not empty."""
    width = table.shape[1]
    for row in range(begin, end):
        source, to = np.uint64(ids[row]), np.uint64(row)
        for place in range(width):
            out[to, np.uint64(place)] = table[source, np.uint64(place)]
        if column.size > 0:
            out[to, np.uint64(width)] = column[to]


@kernel()
def _scatter(begin: int, end: int, gradient: Float32, ids: Int64, out: Float32) -> None:
    """Copy rows to their indices, and fill the gaps in front of them, and the end of the table, with zeros."""
    width = out.shape[1]
    for row in range(begin, end):
        first = ids[row - 1] + 1 if row > 0 else 0
        for gap in range(first, ids[row]):
            for place in range(width):
                out[np.uint64(gap), np.uint64(place)] = np.float32(0.0)
        for place in range(width):
            out[np.uint64(ids[row]), np.uint64(place)] = gradient[np.uint64(row), np.uint64(place)]
    if end == len(ids):
        for gap in range(ids[end - 1] + 1 if end > 0 else 0, len(out)):
            for place in range(width):
                out[np.uint64(gap), np.uint64(place)] = np.float32(0.0)


@kernel()
def _add(begin: int, end: int, numbers: Float32, total: Float64) -> None:
    """Sum numbers in four accumulators."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for i in range(begin, end - 3, 4):
        a += numbers[i]
        b += numbers[i + 1]
        c += numbers[i + 2]
        d += numbers[i + 3]
    for i in range(end - (end - begin) % 4, end):
        a += numbers[i]
    total[0] = a + b + c + d
