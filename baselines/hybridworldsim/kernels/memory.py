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
    """Take an unused block of at least ``size`` bytes: a kept block, or a new one."""
    with _lock:
        unused = [
            block for block, references in zip(_blocks, _reference_counts(_blocks)) if references <= _UNUSED_REFERENCES
        ]
        fits = [block for block in unused if size <= len(block) <= _MAX_OVERSIZE * size]
        if fits:
            return min(fits, key=len)
        block = np.empty(size + size // 8, np.uint8)
        while unused and sum(map(len, _blocks)) + len(block) > _CACHE_BYTES:
            oldest = unused.pop(0)
            _blocks[:] = [other for other in _blocks if other is not oldest]
        if sum(map(len, _blocks)) + len(block) <= _CACHE_BYTES:
            _blocks.append(block)
        return block


def _reference_counts(blocks: list[AnyArray]) -> list[int]:
    """Count the references to each block."""
    return [sys.getrefcount(block) for block in blocks]


_UNUSED_REFERENCES: Final = _reference_counts([np.empty(1, np.uint8)])[0]
"""Number of references to a block that only the list refers to."""
