"""Progress of long work: a bar on a terminal, now and then a line in a log; silent beside ``--json``."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from mirror.ingest.request import Silent

_BETWEEN_LINES_S: Final = 10.0


class Bar:
    """A bar for each phase, on standard error."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._task: TaskID | None = None

    def start(self, what: str, total: int) -> None:
        """Begin a phase."""
        if self._task is not None:
            self._progress.stop_task(self._task)
        self._task = self._progress.add_task(what, total=total)

    def advance(self, steps: int) -> None:
        """Count steps; the bar locks itself."""
        if self._task is not None:
            self._progress.advance(self._task, steps)


class Lines:
    """A line on standard error, at most every ten seconds, where that is a file or a pipe. Short work says nothing."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._what, self._total, self._done = "", 0, 0
        self._said = time.monotonic()

    def start(self, what: str, total: int) -> None:
        """Begin a phase."""
        with self._lock:
            self._what, self._total, self._done = what, total, 0

    def advance(self, steps: int) -> None:
        """Count steps."""
        with self._lock:
            self._done += steps
            now = time.monotonic()
            if now - self._said >= _BETWEEN_LINES_S:
                self._said = now
                print(f"{self._what}: {self._done:,} of {self._total:,}", file=sys.stderr, flush=True)


@contextmanager
def progress_bar(*, quiet: bool) -> Iterator[Bar | Lines | Silent]:
    """Progress while the block runs, on standard error; nothing at all if ``quiet``."""
    console = Console(stderr=True)
    if quiet:
        yield Silent()
        return
    if not console.is_terminal:
        yield Lines()
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        yield Bar(progress)
