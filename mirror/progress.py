"""Progress of long work: its reports, and where they go: a bar on a terminal, lines in a log, or nowhere."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    import rich.progress

BETWEEN_LINES_S: Final = 10.0


class ProgressReporter(Protocol):
    """A receiver of the progress of long work."""

    def start(self, phase: str, total: int) -> None:
        """Begin a phase of ``total`` steps."""

    def expect(self, steps: int) -> None:
        """Add ``steps`` to the phase, which were not known when it began."""

    def advance(self, steps: int) -> None:
        """Count ``steps`` finished steps. May be called from several threads."""

    def status(self, text: str) -> None:
        """Show a short text beside the bar until the next one replaces it."""

    def report(self, text: str) -> None:
        """Print a line where no bar is shown."""

    def message(self, text: str) -> None:
        """Print a line, whether or not a bar is shown."""


class NullProgress:
    """A progress reporter that reports nothing."""

    def start(self, phase: str, total: int) -> None:
        """Do nothing."""

    def expect(self, steps: int) -> None:
        """Do nothing."""

    def advance(self, steps: int) -> None:
        """Do nothing."""

    def status(self, text: str) -> None:
        """Do nothing."""

    def report(self, text: str) -> None:
        """Do nothing."""

    def message(self, text: str) -> None:
        """Do nothing."""


class _Bar:
    """One bar for each phase."""

    def __init__(self, progress: rich.progress.Progress) -> None:
        self._progress = progress
        self._task: rich.progress.TaskID | None = None

    def start(self, phase: str, total: int) -> None:
        if self._task is not None:
            self._progress.stop_task(self._task)
        self._task = self._progress.add_task(phase, total=total, status="")

    def expect(self, steps: int) -> None:
        if self._task is not None:
            task = next(task for task in self._progress.tasks if task.id == self._task)
            self._progress.update(self._task, total=(task.total or 0) + steps)

    def advance(self, steps: int) -> None:
        if self._task is not None:
            self._progress.advance(self._task, steps)

    def status(self, text: str) -> None:
        if self._task is not None:
            self._progress.update(self._task, status=text)

    def report(self, text: str) -> None:
        """The bar shows the same."""

    def message(self, text: str) -> None:
        self._progress.console.print(text, markup=False, highlight=False, soft_wrap=True)


class _Lines:
    """A count at most every ten seconds, for files and pipes. Short work prints nothing."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._phase, self._total, self._done = "", 0, 0
        self._printed = time.monotonic()

    def start(self, phase: str, total: int) -> None:
        with self._lock:
            self._phase, self._total, self._done = phase, total, 0

    def expect(self, steps: int) -> None:
        with self._lock:
            self._total += steps

    def advance(self, steps: int) -> None:
        with self._lock:
            self._done += steps
            if time.monotonic() - self._printed >= BETWEEN_LINES_S:
                self._print(f"{self._phase}: {self._done:,} of {self._total:,}")

    def status(self, text: str) -> None:
        """A line a step would be too many."""

    def report(self, text: str) -> None:
        with self._lock:
            self._print(text)

    def message(self, text: str) -> None:
        with self._lock:
            self._print(text)

    def _print(self, text: str) -> None:
        self._printed = time.monotonic()
        print(text, file=sys.stderr, flush=True)


@contextmanager
def progress_bar(*, quiet: bool) -> Iterator[ProgressReporter]:
    """Report progress on standard error while the block runs.

    Args:
        quiet: report nothing.

    Yields:
        A bar on a terminal, lines elsewhere.
    """
    if quiet:
        yield NullProgress()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _Lines()
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[status]}", markup=False),
    )
    with Progress(*columns, console=console) as progress:
        yield _Bar(progress)
