"""Evaluates an array kernel block by block, so that its temporaries stay in the processor's cache."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from mirror.arrays import AnyArray

BLOCK_VALUES: Final = 32_768


def fill(kernel: Callable[..., None], out: AnyArray, *arrays: AnyArray) -> None:
    """Call ``kernel(out, *arrays)`` on matching blocks of the leading axes.

    A batch of a million poses makes each temporary of a kernel 8 MB: fresh pages from the system, through memory and
    back. In blocks the same work takes a half to a quarter of the time, with the same result bit for bit.

    Args:
        kernel: writes its result into its first argument; every other axis than the last is a batch axis.
        out: (..., K).
        arrays: (..., L) each, with the same number of axes as ``out``; a batch axis has the size of ``out``'s, or 1.
    """
    if out.size <= BLOCK_VALUES or out.ndim == 1:
        kernel(out, *arrays)
        return
    count = out.shape[0]
    step = BLOCK_VALUES * count // out.size
    if step == 0:
        for index in range(count):
            fill(kernel, out[index], *(array[index if len(array) > 1 else 0] for array in arrays))
        return
    for start in range(0, count, step):
        block = slice(start, start + step)
        kernel(out[block], *(array[block] if len(array) > 1 else array for array in arrays))


def split(array: AnyArray) -> AnyArray:
    """Split vectors (..., K) into contiguous components (K, ...)."""
    return np.ascontiguousarray(array.transpose(array.ndim - 1, *range(array.ndim - 1)))
