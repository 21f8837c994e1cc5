"""Memory for arrays that is aligned to cache lines and reused.

A vector across two cache lines costs twice, and a fresh page of the operating system costs more than the computation in
it. Large blocks are therefore kept, and reused when no array refers to them.
"""

from __future__ import annotations

import sys
from threading import Lock
from typing import Any, Final

import numpy as np

from mirror.arrays import AnyArray

_LINE_BYTES: Final = 64
_LARGE_BYTES: Final = 1 << 18
_CACHE_BYTES: Final = 1 << 29
_MAX_OVERSIZE: Final = 2

_blocks: list[AnyArray] = []
_lengths: list[int] = []
"""Bytes of each block."""
_lock: Final = Lock()


def empty_aligned(count: int, dtype: Any = np.float32) -> AnyArray:
    """Make an uninitialised array (count,), aligned to a cache line."""
    size = np.dtype(dtype).itemsize * count
    block = np.empty(size + _LINE_BYTES, np.uint8) if size < _LARGE_BYTES else _take_block(size + _LINE_BYTES)
    skip = -block.__array_interface__["data"][0] % _LINE_BYTES
    return block[skip : skip + size].view(dtype)


def full_aligned(count: int, value: float, dtype: Any = np.float32) -> AnyArray:
    """Make an array (count,) filled with a value, aligned to a cache line."""
    numbers = empty_aligned(count, dtype)
    numbers[:] = value
    return numbers


def _take_block(size: int) -> AnyArray:
    """Take an unused block of at least ``size`` bytes: the smallest kept block that fits, or a new one."""
    with _lock:
        best = -1
        for number, length in enumerate(_lengths):
            if size <= length <= _MAX_OVERSIZE * size and (best < 0 or length < _lengths[best]):
                # Counted for blocks of this size only: every step takes some hundred blocks.
                best = number if _count_references(_blocks, number) <= _UNUSED_REFERENCES else best
        if best >= 0:
            return _blocks[best]
        block = np.empty(size + size // 8, np.uint8)
        number = 0
        while number < len(_blocks) and sum(_lengths) + len(block) > _CACHE_BYTES:
            if _count_references(_blocks, number) <= _UNUSED_REFERENCES:
                del _blocks[number], _lengths[number]
            else:
                number += 1
        if sum(_lengths) + len(block) <= _CACHE_BYTES:
            _blocks.append(block)
            _lengths.append(len(block))
        return block


def _count_references(blocks: list[AnyArray], number: int) -> int:
    """Count the references to a block."""
    return sys.getrefcount(blocks[number])


_UNUSED_REFERENCES: Final = _count_references([np.empty(1, np.uint8)], 0)
"""Number of references to a block that only the list refers to."""
