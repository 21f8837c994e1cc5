"""Adam for tables of which a step uses some rows: the others cost nothing, as in Taming 3DGS and gsplat."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import Optimizer

from hybridworldsim.kernels.dispatch import is_compiled

_EPS = 1e-15
_BETA1, _BETA2 = 0.9, 0.999


class RowAdam(Optimizer):
    """Adam for one table (N, ...); rows that a step does not use keep their moments and values.

    `update` takes a step; `step` does not, because it would need gradients of the complete table. The state has the
    names of torch's Adam, so that gsplat's strategies can add and remove rows.

    Args:
        table: the parameter.
    """

    def __init__(self, table: nn.Parameter) -> None:
        super().__init__([table], {"lr": 0.0})

    @torch.no_grad()
    def update(self, rows: Tensor, gradients: Tensor, first: int = 0, count: int | None = None) -> None:
        """Update some rows; the columns of a row are counted in memory order.

        Args:
            rows: (M,) int64, without repetition.
            gradients: (M, ...) gradients; columns `first` to `first + count` belong to the table.
            first: first column of the gradients.
            count: number of columns; None: all columns of the table.
        """
        if not len(rows):
            return
        (group,) = self.param_groups
        (table,) = group["params"]
        state: dict[str, Any] = self.state[table]
        if "step" not in state:
            state["step"] = torch.tensor(0.0)
            state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(table), torch.zeros_like(table)
        state["step"] += 1.0
        steps = int(state["step"])
        values, first_moments, second_moments = (
            one.detach().view(len(table), -1) for one in (table, state["exp_avg"], state["exp_avg_sq"])
        )
        count = values.shape[1] if count is None else count
        flat = gradients.reshape(len(rows), -1)
        rate, correction = group["lr"] / (1.0 - _BETA1**steps), (1.0 - _BETA2**steps) ** -0.5
        if not is_compiled(table):
            used = flat[:, first : first + count]
            update_rows(rows, used, values, first_moments, second_moments, rate, correction)
            return
        _update(
            rows.numpy(), flat.numpy(), first, count, values.numpy(), first_moments.numpy(), second_moments.numpy(),
            np.float32(rate), np.float32(correction),
        )  # fmt: skip


def update_rows(
    rows: Tensor, gradients: Tensor, table: Tensor, first: Tensor, second: Tensor, rate: float, correction: float
) -> None:
    """Update some rows of a table and of its moments, (N, D), in place, in plain torch on any device.

    Args:
        rows: (M,) int64, without repetition.
        gradients: (M, K) of the first K columns.
        table: the parameters.
        first: first moments.
        second: second moments.
        rate: learning rate, with the bias correction of the first moment.
        correction: factor of the root of the second moment: its bias correction.
    """
    table, first, second = (one[:, : gradients.shape[1]] for one in (table, first, second))
    mean = first.index_select(0, rows).mul_(_BETA1).add_(gradients, alpha=1.0 - _BETA1)
    square = second.index_select(0, rows).mul_(_BETA2).addcmul_(gradients, gradients, value=1.0 - _BETA2)
    first.index_copy_(0, rows, mean)
    second.index_copy_(0, rows, square)
    table.index_add_(0, rows, mean.div_(square.sqrt_().mul_(correction).add_(_EPS)), alpha=-rate)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _update(
    rows: Any,
    gradients: Any,
    offset: int,
    count: int,
    table: Any,
    first: Any,
    second: Any,
    rate: np.float32,
    correction: np.float32,
) -> None:
    b1, b2 = np.float32(_BETA1), np.float32(_BETA2)
    c1, c2 = np.float32(1.0 - _BETA1), np.float32(1.0 - _BETA2)
    eps = np.float32(_EPS)
    for place in range(len(rows)):
        row = rows[place]
        for column in range(count):
            gradient = gradients[place, offset + column]
            mean = b1 * first[row, column] + c1 * gradient
            square = b2 * second[row, column] + c2 * gradient * gradient
            first[row, column] = mean
            second[row, column] = square
            table[row, column] -= rate * mean / (np.sqrt(square) * correction + eps)
