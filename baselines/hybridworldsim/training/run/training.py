"""A training as data: what the loop needs to know of anything that is trained."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from torch import Tensor

from hybridworldsim.training.run.budget import Budget
from hybridworldsim.training.run.curves import Row
from hybridworldsim.training.run.position import Position, Step
from mirror.schema.documents import Document

OutcomeT = TypeVar("OutcomeT", bound=Document)
"""The document of a finished run."""


class Stateful(Protocol):
    """A model with its optimisers, whose state a checkpoint holds."""

    def state(self) -> dict[str, Tensor]:
        """Return everything that training needs to continue exactly, such as parameters, moments and generators."""
        ...

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned.

        Raises:
            KeyError: a tensor is missing.
        """
        ...


@dataclass(frozen=True)
class Ending:
    """The end of a run, from which its outcome is made.

    Attributes:
        position: the last position.
        row: the last row of the curves.
        model_bytes: size of the model's file.
    """

    position: Position
    row: Row
    model_bytes: int


def _ignore(before: Position, now: Position) -> None:
    """Do nothing after a row."""


@dataclass(frozen=True, eq=False)
class Training(Generic[OutcomeT]):
    """A training: its steps, its budget, its state and its outcome.

    Attributes:
        phase: what is trained, for the progress.
        budget: how long.
        trained: what checkpoints hold.
        step: makes a step, from the position and the progress from 0 to 1. It depends on these and on the state only,
            so that a run that was interrupted ends as one that was not.
        learned: tensors by name that must be finite before a row or a checkpoint is written.
        describe: puts the figures of a row into words, for the progress.
        write: writes the model to a path, and returns its size in bytes.
        outcome: makes the document of the finished run, once the model is written.
        remedy: what to do when the numbers are no longer finite.
        after_row: called with the positions before and after each row of the curves, to write charts and samples. Time
            that it takes is not time of training.
        checkpoint_s: a checkpoint is written at the first step after this many seconds.
    """

    phase: str
    budget: Budget
    trained: Stateful
    step: Callable[[Position, float], Step]
    learned: Callable[[], Iterable[tuple[str, Tensor]]]
    describe: Callable[[Row], str]
    write: Callable[[Path], int]
    outcome: Callable[[Ending], OutcomeT]
    remedy: str
    after_row: Callable[[Position, Position], None] = _ignore
    checkpoint_s: float = 60.0
