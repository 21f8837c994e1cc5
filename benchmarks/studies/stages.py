"""The list of a study's stages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol


class Stage(Protocol):
    """A part of a study."""

    @property
    def name(self) -> str:
        """Its name."""
        ...

    @property
    def core_minutes(self) -> float:
        """Its budget."""
        ...


def describe_stages(stages: Iterable[tuple[Stage, bool]]) -> Iterator[str]:
    """Yield one line for each stage: its budget, and whether it is finished.

    Args:
        stages: the stages in their order, each with whether it is finished.
    """
    for stage, is_finished in stages:
        state = "done" if is_finished else "not run"
        yield f"{stage.name:24} {stage.core_minutes:5.1f} core-minutes  {state}"
