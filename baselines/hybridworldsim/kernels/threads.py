"""Runs fixed parts of work on threads; the results do not depend on the number of threads."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache
from itertools import count
from threading import Event, current_thread
from typing import Final

import numpy as np
import torch

from mirror.arrays import Int64

_NAME: Final = "rasterizer"
_SPANS: Final = 4
_MIN_SPAN: Final = 512


def in_parallel(call: Callable[[int], object], parts: int) -> None:
    """Call ``call(0)`` to ``call(parts - 1)`` on torch's number of threads.

    The calls run compiled kernels that release Python's lock. Numba's threading layers are not used: one of them fails
    if two threads render, another in a forked worker.

    After a call has failed no further call starts; its exception is raised when the running calls have ended. Inside
    such a call the parts run one after the other.

    Args:
        call: the function; different parts write to different memory.
        parts: number of calls; they start in order.
    """
    helpers = min(torch.get_num_threads(), parts) - 1
    if helpers <= 0 or current_thread().name.startswith(_NAME):
        for part in range(parts):
            call(part)
        return
    numbers, failed = count(), Event()

    def work() -> None:
        while not failed.is_set() and (part := next(numbers)) < parts:
            try:
                call(part)
            except BaseException:
                failed.set()
                raise

    pool = _pool(helpers, os.getpid())
    futures = [pool.submit(work) for _ in range(helpers)]
    try:
        work()
    finally:
        wait(futures)
    for future in futures:
        future.result()


def spans(count: int) -> Int64:
    """Split rows into spans for `in_parallel`; use it only where the result does not depend on the spans.

    Args:
        count: number of rows.

    Returns:
        (P + 1,) ascending from 0 to `count`.
    """
    threads = torch.get_num_threads()
    parts = 1 if threads == 1 else max(min(_SPANS * threads, count // _MIN_SPAN), 1)
    return count * np.arange(parts + 1) // parts


@lru_cache(maxsize=4)
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    """Make a pool of threads, one per process, because threads do not survive a fork."""
    return ThreadPoolExecutor(threads, f"{_NAME}-{process}")
