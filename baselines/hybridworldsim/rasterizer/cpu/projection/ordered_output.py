"""Collects the output records of parallel parts in the order of the parts."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import Final, NamedTuple

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.kernels.memory import empty_aligned
from hybridworldsim.rasterizer.cpu.projection.ellipses import RECORD
from mirror.arrays import AnyArray, Int64

PART: Final = 16384
"""Number of Gaussians per kernel call. It is constant, so that results do not depend on the number of threads."""

_SPARE: Final = 8  # rows that a kernel may write after its last record


def _empty_records(rows: int) -> tuple[AnyArray, ...]:
    """Make uninitialised arrays as in `RECORD`, with spare rows."""
    return tuple(
        empty_aligned((rows + _SPARE) * math.prod(shape), dtype).reshape(rows + _SPARE, *shape)
        for dtype, shape in RECORD
    )


class _Workspace(NamedTuple):
    """Memory of one part. It is reused, because fresh memory costs more time than the computation."""

    rows: Int64  # (PART + _SPARE,)
    arrays: tuple[AnyArray, ...]


_LOCK: Final = Lock()
_UNUSED: Final[list[_Workspace]] = []


def _borrow_workspace() -> _Workspace:
    with _LOCK:
        if _UNUSED:
            return _UNUSED.pop()
    return _Workspace(np.empty(PART + _SPARE, np.int64), _empty_records(PART))


def _return_workspace(workspace: _Workspace) -> None:
    with _LOCK:
        _UNUSED.append(workspace)


@dataclass
class PartOutput:
    """The output arrays of a part.

    Attributes:
        rows: (PART + 8,) scratch.
        arrays: arrays as in `RECORD`, with 8 spare rows.
        count: number of records; the part sets it.
    """

    rows: Int64
    arrays: tuple[AnyArray, ...]
    count: int = 0


class OrderedOutput:
    """Arrays that parts of unknown length fill in the order of the parts.

    The next part in order writes directly to the arrays. Other parts write to a workspace and are copied later.

    Args:
        capacity: greatest number of rows of all parts together.
    """

    def __init__(self, capacity: int) -> None:
        self._arrays = _empty_records(capacity)
        self._next_part = 0
        self._row_count = 0
        self._finished: dict[int, tuple[int, _Workspace | None]] = {}
        self._lock = Lock()

    @contextmanager
    def open_part(self, number: int) -> Iterator[PartOutput]:
        """Yield the output of a part; its first ``count`` rows are kept.

        Args:
            number: number of the part, counted from 0 without gaps.
        """
        workspace = _borrow_workspace()
        with self._lock:
            in_place = number == self._next_part
            arrays = tuple(array[self._row_count :] for array in self._arrays) if in_place else workspace.arrays
        output = PartOutput(workspace.rows, arrays)
        yield output
        if in_place:
            _return_workspace(workspace)
        self._finish_part(number, output.count, None if in_place else workspace)

    def _finish_part(self, number: int, count: int, workspace: _Workspace | None) -> None:
        """Copy the rows of this part, and of finished parts behind it, if all parts in front are done."""
        to_move = []
        with self._lock:
            self._finished[number] = count, workspace
            while self._next_part in self._finished:
                count, source = self._finished.pop(self._next_part)
                if source is not None:
                    to_move.append((self._row_count, count, source))
                self._row_count += count
                self._next_part += 1
        for begin, count, source in to_move:
            for array, rows in zip(self._arrays, source.arrays):
                array[begin : begin + count] = rows[:count]
            _return_workspace(source)

    def tensors(self) -> tuple[Tensor, ...]:
        """Return the rows of all parts; call it when all parts are done."""
        return tuple(torch.from_numpy(array[: self._row_count]) for array in self._arrays)
