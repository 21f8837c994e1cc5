"""Jobs of the tests of executors; workers import them from here."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

from mirror.errors import UsageError

CRASHING, ENDLESS, REFUSED, BROKEN, UNSENDABLE, FLAKY = range(101, 107)


def make(factor: int, folder: str) -> Callable[[int], object]:
    def work(item: int) -> object:
        # One byte an attempt, from any process.
        with Path(folder, f"{item}.attempts").open("ab") as file:
            file.write(b"x")
        if item == CRASHING:
            os.kill(os.getpid(), signal.SIGSEGV)
        if item == ENDLESS:
            while True:
                time.sleep(0.01)
        if item == REFUSED:
            raise UsageError("refused")
        if item == BROKEN:
            raise ValueError("broken")
        if item == UNSENDABLE:
            return threading.Lock()
        if item == FLAKY and Path(folder, f"{item}.attempts").stat().st_size < 3:
            os._exit(9)
        return None if item == 0 else factor * item

    return work


def fail_to_make(factor: int, folder: str) -> Callable[[int], int]:
    raise UsageError(f"no model in {folder}")


def end_process(factor: int, folder: str) -> Callable[[int], int]:
    os._exit(7)


def signals_held_back() -> Callable[[int], bool]:
    return lambda item: signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def thread_limits() -> Callable[[int], tuple[int, int]]:
    import cv2
    import numba

    return lambda item: (cv2.getNumThreads(), numba.get_num_threads())
