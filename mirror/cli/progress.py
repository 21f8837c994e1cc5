"""Progress of long work on a terminal: what, how far, how long still. Silent where nobody watches."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from mirror.ingest.request import Silent


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


@contextmanager
def progress_bar(*, quiet: bool) -> Iterator[Bar | Silent]:
    """A bar while the block runs, if standard error is a terminal and ``quiet`` is false."""
    console = Console(stderr=True)
    if quiet or not console.is_terminal:
        yield Silent()
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        yield Bar(progress)
