"""Pools of threads and processes that end at once when their work is interrupted or fails.

The pools of the standard library wait for all that was asked of them, also after Ctrl-C. Here what has not begun is
dropped; worker processes are killed, threads finish the one piece that each is at.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
from types import FrameType
from typing import Any, Final, ParamSpec, TypeVar

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")

ONE_THREAD: Final = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)


@contextmanager
def thread_pool(threads: int) -> Iterator[ThreadPoolExecutor]:
    """Open a pool of threads; if the block ends with an error, tasks that have not begun are dropped.

    Args:
        threads: how many.
    """
    pool = ThreadPoolExecutor(threads)
    try:
        yield pool
    except BaseException:
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


class ProcessPool:
    """A pool of worker processes; `process_pool` opens it."""

    def __init__(self, pool: ProcessPoolExecutor) -> None:
        self._pool = pool

    def submit(
        self, work: Callable[_Arguments, _Result], *args: _Arguments.args, **kwargs: _Arguments.kwargs
    ) -> Future[_Result]:
        """Submit a call as `concurrent.futures.Executor.submit` does; processes start as they are needed."""
        with undisturbed():
            return self._pool.submit(work, *args, **kwargs)


@contextmanager
def process_pool(
    workers: int, begin: Callable[_Arguments, None], *args: _Arguments.args, **kwargs: _Arguments.kwargs
) -> Iterator[ProcessPool]:
    """Open a pool of worker processes, in each of which a library uses one thread.

    They never hear Ctrl-C, which a terminal sends to all processes of a command, and they end when this process does,
    however it ends. Where the block ends with an error they are killed.

    Args:
        workers: how many.
        begin: called first in each worker.
        args: of it.
        kwargs: of it.
    """
    # A forked child that enters a parallel numba kernel after its parent did dies.
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    with one_thread_each():
        pool = ProcessPoolExecutor(workers, context, _begin, (begin, args, kwargs))
        try:
            yield ProcessPool(pool)
        except BaseException:
            for process in set(multiprocessing.active_children()) - others:
                process.kill()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        pool.shutdown()


def _begin(begin: Callable[..., None], args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
    threading.Thread(target=end_with_parent, name="mirror-parent", daemon=True).start()
    begin(*args, **kwargs)


def end_with_parent() -> None:
    """End this process when its parent has ended; run it in a thread of a worker."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Keep Ctrl-C from the block and from the processes that it starts; it takes effect after the block.

    A process that starts inherits which signals are held back, from before its first instruction on. One whose parent
    is interrupted while it hands over the worker's arguments would print an error.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        # Nobody hears it here.
        with _held_back():
            yield
        return
    late: list[int] = []

    def remember(number: int, frame: FrameType | None) -> None:
        late.append(number)

    signal.signal(signal.SIGINT, remember)
    try:
        with _held_back():
            yield
    finally:
        signal.signal(signal.SIGINT, before)
        if late:
            signal.raise_signal(signal.SIGINT)


@contextmanager
def _held_back() -> Iterator[None]:
    # Starting it unblocks SIGINT, so that the process that is started next would hear it.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Limit the libraries of processes that the block starts to one thread each."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
