"""The rows of some Gaussians out of all, and back, with gradients."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor


class _TakeRows(torch.autograd.Function):
    """Rows that each occur once: their gradients are copied where torch's own `index_select` would add."""

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
    """Rows of a table; the table itself if these are all.

    Args:
        table: (N, ...).
        ids: (M,) int64, ascending, each once.

    Returns:
        (M, ...).
    """
    if len(ids) == len(table):
        return table
    if has_kernels(table):
        from hybridworldsim.rasterizer.cpu import tables

        return tables.take_rows(table, ids)
    found: Tensor = _TakeRows.apply(table, ids)
    return found


def copy_rows(table: Tensor, ids: Tensor) -> Tensor:
    """Rows of a table as `rows` gives them, but never the table itself: who holds it may write into it."""
    found = take_rows(table, ids)
    if found is not table:
        return found
    if has_kernels(table):
        from hybridworldsim.rasterizer.cpu import tables

        return tables.take_rows(table, ids)
    return table.clone()


def take_rows_with_column(table: Tensor, ids: Tensor, column: Tensor) -> Tensor:
    """Rows of a table, with another column beside them.

    Args:
        table: (N, D).
        ids: (M,) int64, ascending, each once.
        column: (M,).

    Returns:
        (M, D + 1).
    """
    if has_kernels(table) and has_kernels(column):
        from hybridworldsim.rasterizer.cpu import tables

        return tables.take_rows(table, ids, column)
    return torch.cat([take_rows(table, ids).to(column.dtype), column[:, None]], dim=-1)


def has_kernels(table: Tensor) -> bool:
    """Whether compiled kernels take a table."""
    return table.device.type == "cpu" and table.dtype == torch.float32


def scatter_rows(part: Tensor, ids: Tensor, count: int) -> Tensor:
    """A table that holds some rows where they belong, and zero elsewhere; the rows themselves if they are all.

    Args:
        part: (M, ...).
        ids: (M,) int64, ascending, each once.
        count: N, how many rows the table has.

    Returns:
        (N, ...).
    """
    if len(ids) == count:
        return part
    return part.new_zeros((count, *part.shape[1:])).index_copy(0, ids, part)
