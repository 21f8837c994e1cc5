"""What an evaluation or a training tells of how far it is."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Told of phases and their steps."""

    def start(self, what: str, total: int) -> None:
        """A phase of so many steps begins."""

    def advance(self, steps: int) -> None:
        """So many steps are done."""


class Watch(Progress, Protocol):
    """Told how it goes as well."""

    def now(self, words: str) -> None:
        """How it stands: shown beside the bar until the next."""

    def report(self, words: str) -> None:
        """How it stood: a line where no bar moves."""

    def say(self, words: str) -> None:
        """What is worth knowing afterwards: a line, with or without a bar."""


class Silent:
    """Nobody watches."""

    def start(self, what: str, total: int) -> None:
        """Nothing."""

    def advance(self, steps: int) -> None:
        """Nothing."""

    def now(self, words: str) -> None:
        """Nothing."""

    def report(self, words: str) -> None:
        """Nothing."""

    def say(self, words: str) -> None:
        """Nothing."""
