"""Ctrl-C and SIGTERM end a command within seconds, with exit code 130 and without a traceback, whatever it is doing.

A command that does its work hears a signal as `KeyboardInterrupt`, so that it removes temporary files and keeps what is
complete. That alone is not enough: an import, a callback of a C library or a thread that is waited for may swallow the
exception or hold it up. So a thread that the system's own signal handler wakes ends the process after a few seconds.
Nothing is lost by that: what is written is written under a temporary name, and renamed when it is complete.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

TYPE_CHECKING = False
if TYPE_CHECKING:
    # What is imported before signals are heard is imported while they are not.
    from types import FrameType
    from typing import Any, Final, NoReturn

INTERRUPTED: Final = 130
"""Exit code of a command that was interrupted."""

_GRACE_S: Final = 3.0
_POLL_S: Final = 0.5
_SHOW_CURSOR: Final = b"\x1b[?25h"


def interrupted(command: str) -> str:
    """Say that a command was interrupted, or, if it serves until it is stopped, that it was stopped."""
    is_server = command.split()[1:2] in (["view"], ["serve"])
    return f"{command}: stopped" if is_server else f"{command}: interrupted: run the same command again"


@contextmanager
def terminable() -> Iterator[None]:
    """Treat SIGTERM as Ctrl-C while the block runs; without effect outside the main thread."""

    def on_signal(number: int, frame: FrameType | None) -> None:
        if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
            # In the background of a script Ctrl-C is ignored, and a scheduler's signal is not.
            raise KeyboardInterrupt
        signal.raise_signal(signal.SIGINT)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, on_signal)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


_finishing = threading.Event()


@contextmanager
def finishing() -> Iterator[None]:
    """Keep the first signal from ending the process after a few seconds, however long the block takes.

    For work that hears signals itself and ends as soon as it has saved what is worth it. A second signal ends the
    process within seconds.
    """
    before = _finishing.is_set()
    _finishing.set()
    try:
        yield
    finally:
        if not before:
            _finishing.clear()


def _read_stop(reader: int) -> int | None:
    """The number of the signal that comes next; None: it does not stop a command."""
    number = os.read(reader, 1)[0]
    return number if number in (signal.SIGINT, signal.SIGTERM) else None


class Stops:
    """The signals of a process that runs one command.

    Before the command's work begins, while modules are imported, a signal ends the process at once: nothing is being
    written then. During the work the first signal raises `KeyboardInterrupt`; a second signal,
    or the end of the time that is left for tidying up, ends the process.

    Args:
        command: as it was typed, for the message.
    """

    def __init__(self, command: str) -> None:
        self._command = command
        self._working = False
        self._asked = False
        self._noticed = threading.Event()

    @property
    def heard(self) -> bool:
        """Return whether a signal came."""
        return self._asked or self._noticed.is_set()

    def listen(self) -> None:
        """Handle signals from now on, to the end of the process."""
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self._on_signal)
        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        # Python's handlers run only between steps of the main thread; this is written at once, whoever handles it.
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        threading.Thread(target=self._watch, args=(reader,), name="mirror-stops", daemon=True).start()
        self._silence()

    def work(self, run: Callable[[], int]) -> int:
        """Do the command's work; if a signal came, end the process afterwards.

        Args:
            run: the work; it returns the exit code.
        """
        code: int | None = None
        try:
            try:
                self._working = True
                code = run()
            finally:
                self._working = False
        except BaseException:
            # A C library may have turned the interruption into another error.
            if not self.heard:
                raise
        if code is None or self.heard:
            self.end(say=code != INTERRUPTED)
        # The work is complete: from here on the process only ends, with the exit code of the work.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        return code

    def end(self, *, say: bool = True) -> NoReturn:
        """End the process now, with the exit code of an interruption."""
        # Past Python's buffers, which what was interrupted may have locked. A progress bar hides the cursor.
        with suppress(OSError):
            os.write(2, _SHOW_CURSOR if os.isatty(2) else b"")
            os.write(2, f"{interrupted(self._command)}\n".encode() if say else b"")
        os._exit(INTERRUPTED)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self._asked or not self._working:
            self.end()
        self._asked = True
        raise KeyboardInterrupt

    def _watch(self, reader: int) -> None:
        while (first := _read_stop(reader)) is None:
            pass
        self._noticed.set()
        # `terminable` turns SIGTERM into SIGINT, which is no second signal then.
        second = {signal.SIGINT, signal.SIGTERM} if first == signal.SIGINT else {signal.SIGTERM}
        end_s = time.monotonic() + _GRACE_S
        while (left_s := end_s - time.monotonic()) > 0.0:
            ready, _, _ = select.select([reader], [], [], min(left_s, _POLL_S))
            again = bool(ready) and _read_stop(reader) in second
            if _finishing.is_set():
                if again:
                    # What is being finished is given up.
                    threading.Event().wait(_GRACE_S)
                    break
                end_s = time.monotonic() + _GRACE_S
        self.end()

    def _silence(self) -> None:
        """After a signal the errors that it caused are not printed: not those in threads, callbacks or destructors."""
        for module, name in ((sys, "excepthook"), (sys, "unraisablehook"), (threading, "excepthook")):
            setattr(module, name, self._unless_heard(getattr(module, name)))

    def _unless_heard(self, show: Callable[..., None]) -> Callable[..., None]:
        def shown(*about: Any) -> None:
            if not self.heard:
                show(*about)

        return shown


def run_process(command: str, run: Callable[[], int]) -> int:
    """Do a command's work as the only work of this process, which signals end; see `Stops`.

    Args:
        command: as it is typed, for messages.
        run: it returns the exit code.

    Returns:
        The exit code.
    """
    if threading.current_thread() is not threading.main_thread():
        return run()
    stops = Stops(command)
    stops.listen()
    return stops.work(run)
