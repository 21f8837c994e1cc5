"""Records of the Gaussians that are seen, one after the other, whichever part of them is ready first."""

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
"""Gaussians that one call of a kernel takes: results are the same for any number of threads as long as this is."""

_SPARE: Final = 8  # rows that a kernel may write beyond what it keeps


def _empty_records(rows: int) -> tuple[AnyArray, ...]:
    return tuple(
        empty_aligned((rows + _SPARE) * math.prod(shape), dtype).reshape(rows + _SPARE, *shape)
        for dtype, shape in RECORD
    )


class _Workspace(NamedTuple):
    """Memory that one part needs for a while; kept, as fresh memory costs more than what is computed in it."""

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
    """Where a part writes.

    Attributes:
        rows: (PART + 8,) for its own use.
        arrays: as in `RECORD`, with 8 rows more than the part can fill.
        count: how many it has filled.
    """

    rows: Int64
    arrays: tuple[AnyArray, ...]
    count: int = 0


class OrderedOutput:
    """Arrays that parts of unknown length fill in order.

    The part whose turn it is writes where it belongs; others write elsewhere and are moved.

    Args:
        capacity: rows of all parts together.
    """

    def __init__(self, capacity: int) -> None:
        self._arrays = _empty_records(capacity)
        self._next_part = 0
        self._row_count = 0
        self._finished: dict[int, tuple[int, _Workspace | None]] = {}
        self._lock = Lock()

    @contextmanager
    def open_part(self, number: int) -> Iterator[PartOutput]:
        """A place for a part, whose first ``count`` rows are taken in the end.

        Args:
            number: of the part; they count from 0, and none is left out.
        """
        workspace = _borrow_workspace()
        with self._lock:
            in_place = number == self._next_part
            arrays = tuple(array[self._row_count :] for array in self._arrays) if in_place else workspace.arrays
        place = PartOutput(workspace.rows, arrays)
        yield place
        if in_place:
            _return_workspace(workspace)
        self._finish_part(number, place.count, None if in_place else workspace)

    def _finish_part(self, number: int, count: int, workspace: _Workspace | None) -> None:
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
        """All parts' rows, once each part is done."""
        return tuple(torch.from_numpy(array[: self._row_count]) for array in self._arrays)
