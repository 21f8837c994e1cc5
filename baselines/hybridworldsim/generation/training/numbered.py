"""The training of an autoencoder or a generator, whose steps depend on their numbers, for the loop of all trainings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final, Protocol

from hybridworldsim.generation.training.documents import GenerationOutcome
from hybridworldsim.training.run.budget import Budget
from hybridworldsim.training.run.position import Position, Step
from hybridworldsim.training.run.training import Ending, Stateful, Training

_SAMPLES_EVERY: Final = 10


class NumberedTrainer(Stateful, Protocol):
    """A trainer whose steps depend on their number, the seed and the state only."""

    def step(self, number: int) -> dict[str, float]:
        """Do a step; returns the losses by name."""
        ...


def numbered_training(
    trainer: NumberedTrainer,
    steps: int,
    write: Callable[[Path], int],
    *,
    phase: str,
    loss: str,
    checkpoint_s: float = 60.0,
    sample: Callable[[int], None] | None = None,
    psnr_db: Callable[[], float] | None = None,
) -> Training[GenerationOutcome]:
    """Make a training that takes a number of steps.

    Args:
        trainer: what is trained.
        steps: number of steps.
        write: writes the trained model to a path, and returns its size in bytes.
        phase: what is trained, for the progress.
        loss: name of the loss.
        checkpoint_s: a checkpoint is written at the first step after this many seconds.
        sample: called with the number of steps after every tenth row of the curves, to write samples.
        psnr_db: gives the PSNR of images that the model reconstructs, once it is written.
    """

    def after_row(_: Position, now: Position) -> None:
        if sample is not None and now.rows % _SAMPLES_EVERY == 0:
            sample(now.steps)

    def outcome(ending: Ending) -> GenerationOutcome:
        position = ending.position
        return GenerationOutcome(
            steps=position.steps, core_s=position.spent_s, wall_s=position.wall_s, loss=ending.row[loss],
            model_bytes=ending.model_bytes, psnr_db=None if psnr_db is None else psnr_db(),
        )  # fmt: skip

    return Training(
        phase=phase,
        budget=Budget(steps=steps),
        trained=trainer,
        step=lambda position, _: Step(trainer.step(position.steps)),
        learned=lambda: trainer.state().items(),
        describe=lambda row: f"{loss} {row[loss]:.5f}",
        write=write,
        outcome=outcome,
        remedy="train again with a lower learning rate",
        after_row=after_row,
        checkpoint_s=checkpoint_s,
    )
