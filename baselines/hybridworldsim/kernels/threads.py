"""Work in fixed parts on some threads: what comes out does not depend on how many there are."""

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
_LEAST_SPAN: Final = 512


def in_parallel(call: Callable[[int], object], parts: int) -> None:
    """Call ``call(0)`` to ``call(parts - 1)``, on as many threads as torch has.

    The calls run compiled kernels that let go of Python's lock. Numba's own threading layers are not used: one of them
    fails where two threads render, another in a forked worker.

    Once a call fails, no other begins, and its exception is raised when those that had begun are done. From within such
    a call the parts run one after the other.

    Args:
        call: writes where no other call does.
        parts: how many calls; the earliest begin first.
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
    waiting = [pool.submit(work) for _ in range(helpers)]
    try:
        work()
    finally:
        wait(waiting)
    for one in waiting:
        one.result()


def spans(count: int) -> Int64:
    """Edges of spans of rows for `in_parallel`, where what comes out does not depend on how the rows are cut.

    Args:
        count: of rows.

    Returns:
        (P + 1,) ascending from 0 to `count`.
    """
    threads = torch.get_num_threads()
    parts = 1 if threads == 1 else max(min(_SPANS * threads, count // _LEAST_SPAN), 1)
    return count * np.arange(parts + 1) // parts


@lru_cache(maxsize=4)
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    """One a process: threads do not survive a fork."""
    return ThreadPoolExecutor(threads, f"{_NAME}-{process}")
