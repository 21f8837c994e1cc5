"""Training as it is watched: a bar with words on a terminal, lines elsewhere, nothing where JSON is asked for."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn

from mirror.evaluation.progress import Silent, Watch


class _Bar:
    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._task: TaskID | None = None

    def start(self, what: str, total: int) -> None:
        if self._task is not None:
            self._progress.remove_task(self._task)
        self._task = self._progress.add_task(what, total=total, words="")

    def advance(self, steps: int) -> None:
        if self._task is not None:
            self._progress.advance(self._task, steps)

    def now(self, words: str) -> None:
        if self._task is not None:
            self._progress.update(self._task, words=words)

    def report(self, words: str) -> None:
        """The bar says it."""

    def say(self, words: str) -> None:
        self._progress.console.print(words, markup=False, highlight=False, soft_wrap=True)


class _Lines:
    def start(self, what: str, total: int) -> None:
        """A line would tell nothing."""

    def advance(self, steps: int) -> None:
        """A line a step is too many."""

    def now(self, words: str) -> None:
        """It changes too fast to be written down."""

    def report(self, words: str) -> None:
        self.say(words)

    def say(self, words: str) -> None:
        print(words, file=sys.stderr, flush=True)


@contextmanager
def watching(*, quiet: bool) -> Iterator[Watch]:
    """What to tell while the block runs; on standard error.

    Args:
        quiet: nobody wants to know.
    """
    console = Console(stderr=True)
    if quiet:
        yield Silent()
    elif not console.is_terminal:
        yield _Lines()
    else:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[words]}"),
        )
        with Progress(*columns, console=console) as progress:
            yield _Bar(progress)
