"""Ctrl-C during training: heard between steps, so that a checkpoint can be written."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from mirror.stops import finishing


@contextmanager
def interruptible() -> Iterator[threading.Event]:
    """Defer Ctrl-C to the end of a step, as the state within a step cannot be saved; a second one interrupts at once.

    Yields:
        An event that is set after the first Ctrl-C.
    """
    interrupted = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield interrupted
        return
    previous = signal.getsignal(signal.SIGINT)
    if previous == signal.SIG_IGN:
        # A shell starts background jobs with SIGINT ignored: keep it ignored.
        yield interrupted
        return

    def on_signal(number: int, frame: FrameType | None) -> None:
        if interrupted.is_set():
            raise KeyboardInterrupt
        interrupted.set()

    signal.signal(signal.SIGINT, on_signal)
    try:
        # A step and a checkpoint may take longer than a process is given to end after a signal.
        with finishing():
            yield interrupted
    finally:
        signal.signal(signal.SIGINT, previous)
