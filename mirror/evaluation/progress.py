"""What an evaluation tells of how far it is."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Told of phases and their steps."""

    def start(self, what: str, total: int) -> None:
        """A phase of so many steps begins."""

    def advance(self, steps: int) -> None:
        """So many steps are done."""


class Silent:
    """Nobody watches."""

    def start(self, what: str, total: int) -> None:
        """Nothing."""

    def advance(self, steps: int) -> None:
        """Nothing."""
