"""Work in fixed parts on some threads: what comes out does not depend on how many there are."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache
from itertools import count
from threading import Event, current_thread
from typing import Final

import torch

_NAME: Final = "rasterizer"


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
    numbers, failed = count(), Event()

    def work() -> None:
        while not failed.is_set() and (part := next(numbers)) < parts:
            try:
                call(part)
            except BaseException:
                failed.set()
                raise

    helpers = min(torch.get_num_threads(), parts) - 1
    if helpers <= 0 or current_thread().name.startswith(_NAME):
        work()
        return
    pool = _pool(helpers, os.getpid())
    waiting = [pool.submit(work) for _ in range(helpers)]
    try:
        work()
    finally:
        wait(waiting)
    for one in waiting:
        one.result()


@lru_cache(maxsize=4)
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    """One a process: threads do not survive a fork."""
    return ThreadPoolExecutor(threads, f"{_NAME}-{process}")
