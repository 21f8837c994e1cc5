"""Runs fixed parts of work on threads; the results do not depend on the number of threads."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache
from itertools import count
from threading import Event, local
from typing import Final

import numba
import numpy as np

from mirror.arrays import Int64

_NAME: Final = "rasterizer"
_SPANS: Final = 4
_MIN_SPAN: Final = 512
_MIN_ROWS: Final = 24
_inside: Final = local()
"""Has ``a_call`` in threads that run a call of `in_parallel`, the calling thread included."""


def in_parallel(call: Callable[[int], object], parts: int, threads: int | None = None) -> None:
    """Call ``call(0)`` to ``call(parts - 1)`` on threads.

    The calls run compiled kernels that release Python's lock. Numba's threading layers are not used: one of them fails
    if two threads render, another in a forked worker.

    After a call has failed no further call starts; its exception is raised when the running calls have ended. Inside
    such a call the parts run one after the other.

    Args:
        call: the function; different parts write to different memory.
        parts: number of calls; they start in order.
        threads: number of threads; None: torch's.
    """
    helpers = min(_torch_threads() if threads is None else threads, parts) - 1
    if helpers <= 0 or getattr(_inside, "a_call", False):
        for part in range(parts):
            call(part)
        return
    numbers, failed = count(), Event()

    def work() -> None:
        _inside.a_call = True
        try:
            while not failed.is_set() and (part := next(numbers)) < parts:
                call(part)
        except BaseException:
            failed.set()
            raise
        finally:
            _inside.a_call = False

    pool = _pool(helpers, os.getpid())
    futures = [pool.submit(work) for _ in range(helpers)]
    try:
        work()
    finally:
        # Nothing is left for a thread that has not begun, because it is busy with the work of another caller.
        begun = [future for future in futures if not future.cancel()]
        wait(begun)
    for future in begun:
        future.result()


def in_row_spans(call: Callable[[int, int], object], rows: int) -> None:
    """Call ``call(begin, end)`` for spans of the rows of an image, on `numba_threads` threads.

    Args:
        call: the function; different rows write to different memory.
        rows: number of rows.
    """
    threads = numba_threads()
    parts = max(min(_SPANS * threads, rows // _MIN_ROWS), 1) if threads > 1 else 1
    in_parallel(lambda part: call(rows * part // parts, rows * (part + 1) // parts), parts, threads)


def numba_threads() -> int:
    """Return Numba's number of threads, for kernels that do without torch: the cores, or ``NUMBA_NUM_THREADS``."""
    return int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


def spans(count: int) -> Int64:
    """Split rows into spans for `in_parallel`; use it only where the result does not depend on the spans.

    Inside a call of `in_parallel`, where the parts run one after the other, there is one span.

    Args:
        count: number of rows.

    Returns:
        (P + 1,) ascending from 0 to `count`.
    """
    threads = 1 if getattr(_inside, "a_call", False) else _torch_threads()
    parts = 1 if threads == 1 else max(min(_SPANS * threads, count // _MIN_SPAN), 1)
    return count * np.arange(parts + 1) // parts


def _torch_threads() -> int:
    import torch

    return torch.get_num_threads()


@lru_cache(maxsize=4)
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    """Make a pool of threads, one per process, because threads do not survive a fork."""
    return ThreadPoolExecutor(threads, f"{_NAME}-{process}")
