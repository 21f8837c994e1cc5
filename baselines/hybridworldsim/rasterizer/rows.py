"""Takes the rows of some Gaussians from a table, and scatters rows into a table, with gradients."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor


class _TakeRows(torch.autograd.Function):
    """Takes unique rows: their gradients are copied, where torch's `index_select` adds them."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, ids: Tensor) -> Tensor:
        ctx.save_for_backward(ids)
        ctx.shape = table.shape
        return table.index_select(0, ids)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        (gradient,) = gradients
        (ids,) = ctx.saved_tensors
        return gradient.new_zeros(ctx.shape).index_copy_(0, ids, gradient), None


def take_rows(table: Tensor, ids: Tensor) -> Tensor:
    """Take rows of a table; return the table itself if all rows are taken.

    Args:
        table: (N, ...).
        ids: (M,) int64, ascending, unique.

    Returns:
        (M, ...).
    """
    if len(ids) == len(table):
        return table
    if has_kernels(table):
        from hybridworldsim.rasterizer.cpu import tables

        return tables.take_rows(table, ids)
    taken: Tensor = _TakeRows.apply(table, ids)
    return taken


def copy_rows(table: Tensor, ids: Tensor) -> Tensor:
    """Copy rows of a table; unlike `take_rows`, never return the table itself."""
    taken = take_rows(table, ids)
    if taken is not table:
        return taken
    if has_kernels(table):
        from hybridworldsim.rasterizer.cpu import tables

        return tables.take_rows(table, ids)
    return table.clone()


def take_rows_with_column(table: Tensor, ids: Tensor, column: Tensor) -> Tensor:
    """Take rows of a table and append a column.

    Args:
        table: (N, D).
        ids: (M,) int64, ascending, unique.
        column: (M,).

    Returns:
        (M, D + 1).
    """
    if has_kernels(table) and has_kernels(column):
        from hybridworldsim.rasterizer.cpu import tables

        return tables.take_rows(table, ids, column)
    return torch.cat([take_rows(table, ids).to(column.dtype), column[:, None]], dim=-1)


def has_kernels(table: Tensor) -> bool:
    """Return whether compiled kernels support a table: float32 on the CPU."""
    return table.device.type == "cpu" and table.dtype == torch.float32


def scatter_rows(part: Tensor, ids: Tensor, count: int) -> Tensor:
    """Scatter rows into a table of zeros; return the rows themselves if they fill the table.

    Args:
        part: (M, ...).
        ids: (M,) int64, ascending, unique.
        count: N, number of rows of the table.

    Returns:
        (N, ...).
    """
    if len(ids) == count:
        return part
    return part.new_zeros((count, *part.shape[1:])).index_copy(0, ids, part)
