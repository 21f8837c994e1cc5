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

from hybridworldsim.kernels.memory import room
from hybridworldsim.rasterizer.cpu.projection.ellipses import RECORD
from mirror.arrays import AnyArray, Int64

PART: Final = 16384
"""Gaussians that one call of a kernel takes: results are the same for any number of threads as long as this is."""

_SPARE: Final = 8  # rows that a kernel may write beyond what it keeps


def _empty(rows: int) -> tuple[AnyArray, ...]:
    return tuple(
        room((rows + _SPARE) * math.prod(shape), dtype).reshape(rows + _SPARE, *shape) for dtype, shape in RECORD
    )


class _Workspace(NamedTuple):
    """Memory that one part needs for a while; kept, as fresh memory costs more than what is computed in it."""

    rows: Int64  # (PART + _SPARE,)
    arrays: tuple[AnyArray, ...]


_LOCK: Final = Lock()
_FREE: Final[list[_Workspace]] = []


def _taken() -> _Workspace:
    with _LOCK:
        if _FREE:
            return _FREE.pop()
    return _Workspace(np.empty(PART + _SPARE, np.int64), _empty(PART))


def _given_back(workspace: _Workspace) -> None:
    with _LOCK:
        _FREE.append(workspace)


@dataclass
class Place:
    """Where a part writes.

    Attributes:
        rows: (PART + 8,) for its own use.
        arrays: as in `RECORD`, with 8 rows more than the part can fill.
        count: how many it has filled.
    """

    rows: Int64
    arrays: tuple[AnyArray, ...]
    count: int = 0


class InOrder:
    """Arrays that parts of unknown length fill in order.

    The part whose turn it is writes where it belongs; others write elsewhere and are moved.

    Args:
        capacity: rows of all parts together.
    """

    def __init__(self, capacity: int) -> None:
        self._arrays = _empty(capacity)
        self._turn = 0
        self._filled = 0
        self._waiting: dict[int, tuple[int, _Workspace | None]] = {}
        self._lock = Lock()

    @contextmanager
    def part(self, number: int) -> Iterator[Place]:
        """A place for a part, whose first ``count`` rows are taken in the end.

        Args:
            number: of the part; they count from 0, and none is left out.
        """
        workspace = _taken()
        with self._lock:
            settled = number == self._turn
            arrays = tuple(array[self._filled :] for array in self._arrays) if settled else workspace.arrays
        place = Place(workspace.rows, arrays)
        yield place
        if settled:
            _given_back(workspace)
        self._hand_in(number, place.count, None if settled else workspace)

    def _hand_in(self, number: int, count: int, elsewhere: _Workspace | None) -> None:
        due = []
        with self._lock:
            self._waiting[number] = count, elsewhere
            while self._turn in self._waiting:
                ready, source = self._waiting.pop(self._turn)
                if source is not None:
                    due.append((self._filled, ready, source))
                self._filled += ready
                self._turn += 1
        for begin, ready, source in due:
            for array, rows in zip(self._arrays, source.arrays):
                array[begin : begin + ready] = rows[:ready]
            _given_back(source)

    def filled(self) -> tuple[Tensor, ...]:
        """All parts' rows, once each part is done."""
        return tuple(torch.from_numpy(array[: self._filled]) for array in self._arrays)
