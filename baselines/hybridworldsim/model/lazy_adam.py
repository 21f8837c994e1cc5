"""Adam of the tables of a node, of which a step sees some rows: the others cost nothing until they are seen again."""

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
"""A hundred steps of memory, not Adam's thousand: an image in ten shows a Gaussian, and few of them the same side."""
EPS: Final = 1e-15
_SETTLED: Final = 4096
"""After so many steps Adam's corrections of its first steps are 1 to the last digit."""
_FORGOTTEN: Final = 192
"""After so many steps a row does not move any more in float32: 0.9045 to this power is 4e-9."""


class LazyAdam:
    """Moves rows as Adam does that is told of gradients of zero for all rows that a step does not see.

    Such a row goes on moving, by what its moments remember, less and less. That has a closed form but for Adam's
    corrections of its first steps, and rows are brought up to date when they are seen next, at the rates of then.

    Args:
        node: that has the tables.
        names: of its parameters with a row for each Gaussian or anchor; those that need no gradient are not moved.

    Attributes:
        names: of the tables that are learnt.
        numbers: (N,) int64 of the rows, ascending: none is ever given twice.
        steps: that were begun.
    """

    def __init__(self, node: nn.Module, names: Sequence[str]) -> None:
        self._node, self._names = node, names
        self.names = [name for name in names if node.get_parameter(name).requires_grad]
        count = len(node.get_parameter(names[0]))
        self._first = {name: torch.zeros_like(node.get_parameter(name)) for name in self.names}
        self._second = {name: torch.zeros_like(node.get_parameter(name)) for name in self.names}
        self._room = {name: torch.empty_like(table) for name, table in self._first.items()}
        self._last = torch.zeros(count, dtype=torch.int64)
        self.numbers = torch.arange(count)
        self._given, self.steps = count, 0
        self._current_step: tuple[Tensor, dict[str, Tensor], Mapping[str, float]] | None = None

    def begin_step(self, rows: Tensor, rates: Mapping[str, float]) -> dict[str, Tensor]:
        """Begin a step.

        Args:
            rows: (M,) int64, ascending, each once.
            rates: of this step, by table.

        Returns:
            Of each table that is learnt its rows (M, ...), up to date: leaves that want a gradient, in room that the
            next step uses again.
        """
        self.steps += 1
        leaves = self._catch_up_rows(rows, rates, self.steps)
        self._current_step = rows, leaves, rates
        return leaves

    def end_step(self) -> None:
        """End a step: move the rows that were taken by their gradients."""
        if self._current_step is None:
            return
        rows, leaves, rates = self._current_step
        self._current_step = None
        ids, edges, share = rows.numpy(), spans(len(rows)), float(_CORRECTIONS[min(self.steps, _SETTLED)])
        for name, leaf in leaves.items():
            gradient = np.zeros_like(_flat(leaf)) if leaf.grad is None else _flat(leaf.grad)
            rate = np.float32(rates[name] * share)
            tables = self._tables(name)
            in_parallel(lambda part: _move(edges[part], edges[part + 1], ids, gradient, rate, *tables), len(edges) - 1)  # noqa: B023

    def catch_up(self, rates: Mapping[str, float]) -> None:
        """Bring all rows up to date, between steps."""
        self._catch_up_rows(torch.arange(len(self._last)), rates, self.steps + 1)
        self._last.fill_(self.steps)

    @torch.no_grad()
    def replace(self, keep: Tensor, added: Mapping[str, Tensor]) -> None:
        """Leave rows out and append others, which have no moments. All rows are to be up to date.

        Args:
            keep: (N,) int64 rows that stay, ascending.
            added: (M, ...) by name, of all tables.
        """
        for name in self._names:
            old = self._node.get_parameter(name)
            table = torch.cat([old.detach()[keep], added[name]])
            setattr(self._node, name, nn.Parameter(table, requires_grad=old.requires_grad))
        for moments in (self._first, self._second):
            for name in self.names:
                moments[name] = torch.cat([moments[name][keep], torch.zeros_like(added[name])])
        self._room = {name: torch.empty_like(table) for name, table in self._first.items()}
        count = len(added[self._names[0]])
        self._last = torch.cat([self._last[keep], torch.full((count,), self.steps)])
        self.numbers = torch.cat([self.numbers[keep], torch.arange(self._given, self._given + count)])
        self._given += count

    def state(self) -> dict[str, Tensor]:
        """All that it keeps."""
        moments = {f"first.{name}": table for name, table in self._first.items()}
        moments |= {f"second.{name}": table for name, table in self._second.items()}
        return {
            **moments, "last": self._last, "numbers": self.numbers, "counters": torch.tensor([self.steps, self._given])
        }  # fmt: skip

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """The opposite of `state`."""
        for name in self.names:
            self._first[name], self._second[name] = state[f"first.{name}"].clone(), state[f"second.{name}"].clone()
            self._room[name] = torch.empty_like(self._first[name])
        self._last, self.numbers = state["last"].clone(), state["numbers"].clone()
        self.steps, self._given = state["counters"].tolist()

    def _catch_up_rows(self, rows: Tensor, rates: Mapping[str, float], step: int) -> dict[str, Tensor]:
        """Rows of the tables as a step finds them, after those before it that did not see them."""
        ids, edges = rows.numpy(), spans(len(rows))
        past = np.empty((len(ids), 3), np.float32)
        asked = ids, step, self._last.numpy(), _CORRECTIONS, past
        in_parallel(lambda part: _measure_missed_steps(edges[part], edges[part + 1], *asked), len(edges) - 1)
        leaves = {}
        for name in self.names:
            out = self._room[name][: len(ids)]
            given = ids, past, np.float32(rates[name]), *self._tables(name), _flat(out)
            in_parallel(lambda part: _take(edges[part], edges[part + 1], *given), len(edges) - 1)  # noqa: B023
            leaves[name] = out.requires_grad_()
        return leaves

    def _tables(self, name: str) -> tuple[AnyArray, AnyArray, AnyArray]:
        return _flat(self._node.get_parameter(name)), _flat(self._first[name]), _flat(self._second[name])


_STEPS: Final = np.arange(1.0, _SETTLED + 1)
_CORRECTIONS: Final = np.concatenate([[0.0], np.sqrt(1.0 - BETA2**_STEPS) / (1.0 - BETA1**_STEPS)])
"""By which Adam's first steps differ from its later ones, by step."""


@kernel()
def _measure_missed_steps(begin: Any, end: Any, rows: Any, step: Any, last: Any, corrections: Any, past: Any) -> None:
    """What passed rows by since they were seen: (M, 3) how far they went on, and what is left of their moments."""
    ratio, settled = BETA1 / math.sqrt(BETA2), len(corrections) - 1
    for place in range(begin, end):
        row = rows[place]
        missed = step - 1 - last[row]
        decay, total = 1.0, 0.0
        for late in range(1, min(missed, _FORGOTTEN) + 1):
            decay *= ratio
            total += decay * corrections[min(last[row] + late, settled)]
        past[place, 0], past[place, 1], past[place, 2] = total, BETA1**missed, BETA2**missed
        last[row] = step


@kernel()
def _take(
    begin: Any, end: Any, rows: Any, past: Any, rate: Any, table: Any, first: Any, second: Any, out: Any
) -> None:  # fmt: skip
    """Rows of a table, brought up to date in it."""
    for place in range(begin, end):
        row = np.uint64(rows[place])
        if past[place, 0] > 0.0:
            far, one, two = rate * past[place, 0], past[place, 1], past[place, 2]
            for column in range(table.shape[1]):
                mean, square = first[row, column], second[row, column]
                table[row, column] -= far * mean / (math.sqrt(square) + np.float32(EPS))
                first[row, column], second[row, column] = mean * one, square * two
        for column in range(table.shape[1]):
            out[place, column] = table[row, column]


@kernel()
def _move(begin: Any, end: Any, rows: Any, gradients: Any, rate: Any, table: Any, first: Any, second: Any) -> None:
    """A step of Adam."""
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
