"""Adam for tables with many rows: a row that a step does not use costs nothing until it is used again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.threads import in_parallel, spans
from mirror.arrays import AnyArray

BETA1: Final = 0.9
BETA2: Final = 0.99
"""Adam's default of 0.999 remembers a thousand steps. A Gaussian is visible in about one image of ten, seldom from the
same side, so a memory of a hundred steps is long enough."""
EPS: Final = 1e-15
_CORRECTED_STEPS: Final = 4096
"""After this many steps Adam's bias corrections are 1 in float32."""
_MEMORY_STEPS: Final = 192
"""After this many missed steps a row no longer moves in float32: 0.9045 to this power is 4e-9."""


class LazyAdam:
    """Adam that treats the gradient of a row as zero in each step that does not use the row.

    Such a row still moves by its moments, less at each step. Without Adam's bias corrections the sum of these moves has
    a closed form. A row is brought up to date when a step uses it again, with the learning rates of that step.

    Args:
        node: module that holds the tables.
        names: parameters with a row for each Gaussian or anchor. A parameter that needs no gradient is not optimised.

    Attributes:
        names: names of the optimised tables.
        numbers: (N,) int64 unique numbers of the rows, ascending; a number is never reused.
        steps: number of steps begun.
    """

    def __init__(self, node: nn.Module, names: Sequence[str]) -> None:
        self._node, self._names = node, names
        self.names = [name for name in names if node.get_parameter(name).requires_grad]
        count = len(node.get_parameter(names[0]))
        self._first = {name: torch.zeros_like(node.get_parameter(name)) for name in self.names}
        self._second = {name: torch.zeros_like(node.get_parameter(name)) for name in self.names}
        self._buffers = {name: torch.empty_like(table) for name, table in self._first.items()}
        self._last_steps = torch.zeros(count, dtype=torch.int64)
        self.numbers = torch.arange(count)
        self._next_number, self.steps = count, 0
        self._current_step: tuple[Tensor, dict[str, Tensor], Mapping[str, float]] | None = None

    def begin_step(self, rows: Tensor, rates: Mapping[str, float]) -> dict[str, Tensor]:
        """Begin a step.

        Args:
            rows: (M,) int64, ascending, without repetition.
            rates: learning rates of this step, by table.

        Returns:
            The rows (M, ...) of each optimised table, up to date: leaves that require a gradient. Their memory is
            reused by the next step.
        """
        self.steps += 1
        leaves = self._catch_up_rows(rows, rates, self.steps)
        self._current_step = rows, leaves, rates
        return leaves

    def end_step(self) -> None:
        """End a step: update the rows of the step by their gradients."""
        if self._current_step is None:
            return
        rows, leaves, rates = self._current_step
        self._current_step = None
        correction = float(_CORRECTIONS[min(self.steps, _CORRECTED_STEPS)])
        for name, leaf in leaves.items():
            self._apply_gradients(name, leaf, rows.numpy(), np.float32(rates[name] * correction))

    def _apply_gradients(self, name: str, leaf: Tensor, ids: AnyArray, rate: np.float32) -> None:
        gradient = np.zeros_like(_flat(leaf)) if leaf.grad is None else _flat(leaf.grad)
        edges, tables = spans(len(ids)), self._tables(name)
        in_parallel(
            lambda part: _apply_gradients(edges[part], edges[part + 1], ids, gradient, rate, *tables), len(edges) - 1
        )

    def catch_up(self, rates: Mapping[str, float]) -> None:
        """Bring all rows up to date, between steps."""
        self._catch_up_rows(torch.arange(len(self._last_steps)), rates, self.steps + 1)
        self._last_steps.fill_(self.steps)

    @torch.no_grad()
    def replace(self, keep: Tensor, added: Mapping[str, Tensor]) -> None:
        """Remove rows and append others without moments; all rows must be up to date.

        Args:
            keep: (N,) int64 rows that stay, ascending.
            added: new rows (M, ...) of all tables, by name.
        """
        for name in self._names:
            old = self._node.get_parameter(name)
            table = torch.cat([old.detach()[keep], added[name]])
            setattr(self._node, name, nn.Parameter(table, requires_grad=old.requires_grad))
        for moments in (self._first, self._second):
            for name in self.names:
                moments[name] = torch.cat([moments[name][keep], torch.zeros_like(added[name])])
        self._buffers = {name: torch.empty_like(table) for name, table in self._first.items()}
        count = len(added[self._names[0]])
        self._last_steps = torch.cat([self._last_steps[keep], torch.full((count,), self.steps)])
        self.numbers = torch.cat([self.numbers[keep], torch.arange(self._next_number, self._next_number + count)])
        self._next_number += count

    def state(self) -> dict[str, Tensor]:
        """Return the moments, row numbers and counters as tensors, for a checkpoint."""
        moments = {f"first.{name}": table for name, table in self._first.items()}
        moments |= {f"second.{name}": table for name, table in self._second.items()}
        counters = torch.tensor([self.steps, self._next_number])
        return {
            **moments, "last": self._last_steps, "numbers": self.numbers, "counters": counters
        }  # fmt: skip

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned."""
        for name in self.names:
            self._first[name], self._second[name] = state[f"first.{name}"].clone(), state[f"second.{name}"].clone()
            self._buffers[name] = torch.empty_like(self._first[name])
        self._last_steps, self.numbers = state["last"].clone(), state["numbers"].clone()
        self.steps, self._next_number = state["counters"].tolist()

    def _catch_up_rows(self, rows: Tensor, rates: Mapping[str, float], step: int) -> dict[str, Tensor]:
        """Bring rows up to the step before `step`, and return copies of them."""
        ids, edges = rows.numpy(), spans(len(rows))
        decayed = np.empty((len(ids), 3), np.float32)
        arguments = ids, step, self._last_steps.numpy(), _CORRECTIONS, decayed
        in_parallel(lambda part: _measure_missed_steps(edges[part], edges[part + 1], *arguments), len(edges) - 1)
        leaves = {}
        for name in self.names:
            out = self._buffers[name][: len(ids)]
            gathered = ids, decayed, np.float32(rates[name]), *self._tables(name), _flat(out)
            in_parallel(lambda part: _gather_rows(edges[part], edges[part + 1], *gathered), len(edges) - 1)  # noqa: B023
            leaves[name] = out.requires_grad_()
        return leaves

    def _tables(self, name: str) -> tuple[AnyArray, AnyArray, AnyArray]:
        return _flat(self._node.get_parameter(name)), _flat(self._first[name]), _flat(self._second[name])


_STEPS: Final = np.arange(1.0, _CORRECTED_STEPS + 1)
_CORRECTIONS: Final = np.concatenate([[0.0], np.sqrt(1.0 - BETA2**_STEPS) / (1.0 - BETA1**_STEPS)])
"""Factors of Adam's bias correction, by step."""


@kernel()
def _measure_missed_steps(
    begin: Any, end: Any, rows: Any, step: Any, last: Any, corrections: Any, decayed: Any
) -> None:
    """Write (M, 3) for the steps that rows missed: the length of the moves, and the decay of both moments."""
    decay_per_step, last_correction = BETA1 / math.sqrt(BETA2), len(corrections) - 1
    for place in range(begin, end):
        row = rows[place]
        missed = step - 1 - last[row]
        decay, total = 1.0, 0.0
        for late in range(1, min(missed, _MEMORY_STEPS) + 1):
            decay *= decay_per_step
            total += decay * corrections[min(last[row] + late, last_correction)]
        decayed[place, 0], decayed[place, 1], decayed[place, 2] = total, BETA1**missed, BETA2**missed
        last[row] = step


@kernel()
def _gather_rows(
    begin: Any, end: Any, rows: Any, decayed: Any, rate: Any, table: Any, first: Any, second: Any, out: Any
) -> None:  # fmt: skip
    """Bring rows of a table up to date in it, and copy them to `out`."""
    for place in range(begin, end):
        row = np.uint64(rows[place])
        if decayed[place, 0] > 0.0:
            scale, decay1, decay2 = rate * decayed[place, 0], decayed[place, 1], decayed[place, 2]
            for column in range(table.shape[1]):
                mean, square = first[row, column], second[row, column]
                table[row, column] -= scale * mean / (math.sqrt(square) + np.float32(EPS))
                first[row, column], second[row, column] = mean * decay1, square * decay2
        for column in range(table.shape[1]):
            out[place, column] = table[row, column]


@kernel()
def _apply_gradients(
    begin: Any, end: Any, rows: Any, gradients: Any, rate: Any, table: Any, first: Any, second: Any
) -> None:
    """Apply a step of Adam to rows of a table."""
    b1, b2 = np.float32(BETA1), np.float32(BETA2)
    c1, c2 = np.float32(1.0 - BETA1), np.float32(1.0 - BETA2)
    for place in range(begin, end):
        row = np.uint64(rows[place])
        for column in range(table.shape[1]):
            gradient = gradients[place, column]
            mean = b1 * first[row, column] + c1 * gradient
            square = b2 * second[row, column] + c2 * gradient * gradient
            first[row, column], second[row, column] = mean, square
            table[row, column] -= rate * mean / (math.sqrt(square) + np.float32(EPS))


def _flat(table: Tensor) -> AnyArray:
    numbers: AnyArray = table.detach().numpy()
    return numbers.reshape(len(numbers), math.prod(numbers.shape[1:]))
