"""Work in fixed parts on some threads: what comes out does not depend on how many there are."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import count

import torch


def in_parallel(call: Callable[[int], object], parts: int) -> None:
    """Call ``call(0)`` to ``call(parts - 1)``, on as many threads as torch has.

    The calls run compiled kernels that let go of Python's lock. Numba's own threading layers are not used: one of them
    fails where two threads render, another in a forked worker.

    Args:
        call: writes where no other call does.
        parts: how many calls; the earliest begin first.
    """
    numbers = count()

    def work() -> None:
        while (part := next(numbers)) < parts:
            call(part)

    helpers = min(torch.get_num_threads(), parts) - 1
    if helpers <= 0:
        work()
        return
    pool = _pool(helpers, os.getpid())
    waiting = [pool.submit(work) for _ in range(helpers)]
    try:
        work()
    finally:
        for one in waiting:
            one.result()


@lru_cache(maxsize=4)
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    """One a process: threads do not survive a fork."""
    return ThreadPoolExecutor(threads, f"rasterizer-{process}")
