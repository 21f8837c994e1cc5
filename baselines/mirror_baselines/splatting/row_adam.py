"""Adam for tables of which a step uses some rows: the others cost nothing, as in Taming 3DGS and gsplat."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import Optimizer

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
            table.detach().view(len(table), -1).numpy() for table in (table, state["exp_avg"], state["exp_avg_sq"])
        )
        _update(
            rows.numpy(),
            gradients.reshape(len(rows), -1).numpy(),
            first,
            values.shape[1] if count is None else count,
            values,
            first_moments,
            second_moments,
            np.float32(group["lr"] / (1.0 - _BETA1**steps)),
            np.float32((1.0 - _BETA2**steps) ** -0.5),
        )


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
