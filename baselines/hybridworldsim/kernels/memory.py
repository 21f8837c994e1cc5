"""Room for arrays: aligned to cache lines, and used again.

A vector that lies across two cache lines costs twice, and a page that the system hands out anew costs more than what is
computed in it. Large pieces are therefore kept, and given out again once nothing refers to them.
"""

from __future__ import annotations

import sys
from threading import Lock
from typing import Any, Final

import numpy as np

from mirror.arrays import AnyArray

_LINE_BYTES: Final = 64
_LARGE_BYTES: Final = 1 << 18
_KEPT_BYTES: Final = 1 << 29
_WASTE: Final = 2

_kept: list[AnyArray] = []
_lock: Final = Lock()


def room(count: int, dtype: Any = np.float32) -> AnyArray:
    """Uninitialised room for numbers (count,)."""
    size = np.dtype(dtype).itemsize * count
    whole = np.empty(size + _LINE_BYTES, np.uint8) if size < _LARGE_BYTES else _piece(size + _LINE_BYTES)
    skip = -whole.ctypes.data % _LINE_BYTES
    return whole[skip : skip + size].view(dtype)


def filled(count: int, value: float, dtype: Any = np.float32) -> AnyArray:
    """Room (count,) with a value in all places."""
    numbers = room(count, dtype)
    numbers[:] = value
    return numbers


def _piece(size: int) -> AnyArray:
    """A piece of at least a size that nothing refers to: one that is kept, or a new one."""
    with _lock:
        free = [piece for piece, holders in zip(_kept, _holders(_kept)) if holders <= _FREE]
        fitting = [piece for piece in free if size <= len(piece) <= _WASTE * size]
        if fitting:
            return min(fitting, key=len)
        piece = np.empty(size + size // 8, np.uint8)
        while free and sum(map(len, _kept)) + len(piece) > _KEPT_BYTES:
            gone = free.pop(0)
            _kept[:] = [other for other in _kept if other is not gone]
        if sum(map(len, _kept)) + len(piece) <= _KEPT_BYTES:
            _kept.append(piece)
        return piece


def _holders(pieces: list[AnyArray]) -> list[int]:
    """How many references each piece has."""
    return [sys.getrefcount(piece) for piece in pieces]


_FREE: Final = _holders([np.empty(1, np.uint8)])[0]
"""As many as one that only the list refers to."""
