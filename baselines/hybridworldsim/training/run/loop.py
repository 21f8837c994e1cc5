"""The loop of all trainings: steps, checkpoints, interruption, curves and progress, from a `Training`."""

from __future__ import annotations

import math
import time
from typing import Final

from hybridworldsim.training.run.budget import Budget, Clock
from hybridworldsim.training.run.folder import RunFolder
from hybridworldsim.training.run.interruption import interruptible
from hybridworldsim.training.run.position import Position, Step
from hybridworldsim.training.run.training import OutcomeT, Training
from mirror.errors import DatasetError
from mirror.progress import ProgressReporter

REPORTS: Final = 40
"""Number of rows of the curves, at equal steps of progress."""

_THOUSAND: Final = 1000


def train(training: Training[OutcomeT], folder: RunFolder[OutcomeT], reporter: ProgressReporter) -> OutcomeT:
    """Train until the budget is spent; continue where an earlier call stopped.

    Under a budget of steps and at one number of threads, interruptions do not change the model. Of several processes,
    the leading one writes; Ctrl-C in one of them stops all after the same step.

    Args:
        training: what is trained.
        folder: folder in which the run began.
        reporter: receives the progress.

    Returns:
        The outcome, which is in the folder, beside the model.

    Raises:
        DatasetError: training diverged, and the last checkpoint is kept; or the checkpoint is broken.
        KeyboardInterrupt: after Ctrl-C, once a checkpoint is written.
    """
    return folder.finish(training, _run_steps(training, folder, reporter))


def _run_steps(training: Training[OutcomeT], folder: RunFolder[OutcomeT], reporter: ProgressReporter) -> Position:
    position = folder.resume(training.trained)
    clock, saved_s = Clock(position.spent_s, position.wall_s), time.monotonic()
    progress = training.budget.progress(position.steps, position.spent_s)
    bar = _Bar(reporter, training.phase, training.budget, position, progress)
    with interruptible() as interrupted:
        while progress < 1.0:
            clock.resume()
            step = training.step(position, progress)
            clock.pause()
            _require_finite_losses(step, position, training, folder)
            position = position.after(step, clock)
            progress = training.budget.progress(position.steps, position.spent_s)
            if bar.advance(position, progress):
                reporter.status(training.describe(position.row(step, progress)))
            if int(progress * REPORTS) > position.reports:
                position = _report(training, folder, reporter, position, step, progress)
            stopped = folder.processes.any(interrupted.is_set())
            if stopped or time.monotonic() - saved_s > training.checkpoint_s:
                folder.save_checkpoint(training, position)
                saved_s = time.monotonic()
            if stopped:
                reporter.message(f"interrupted at step {position.steps}: the checkpoint is in {folder.path}")
                raise KeyboardInterrupt
    folder.save_checkpoint(training, position)
    return position


def _report(
    training: Training[OutcomeT],
    folder: RunFolder[OutcomeT],
    reporter: ProgressReporter,
    position: Position,
    step: Step,
    progress: float,
) -> Position:
    """Write a row of the curves, and print it with the time that is left."""
    folder.require_finite(training, position)
    row = position.row(step, progress)
    folder.append_row(row)
    left_s = position.wall_s * (1.0 - progress) / progress
    reporter.report(
        f"{progress:4.0%}  step {position.steps}  {position.spent_s / 60.0:.2f} core-minutes, "
        f"{left_s / 60.0:.0f} minutes left  {training.describe(row)}"
    )
    now = position.reported(int(progress * REPORTS))
    if folder.processes.leads:
        training.after_row(position, now)
    return now


def _require_finite_losses(
    step: Step, position: Position, training: Training[OutcomeT], folder: RunFolder[OutcomeT]
) -> None:
    for name, loss in step.losses.items():
        if not math.isfinite(loss):
            raise DatasetError(
                f"the loss {name} is {loss} at step {position.steps}", file=folder.path, place=step.place,
                expected="a finite loss", remedy=training.remedy,
            )  # fmt: skip


class _Bar:
    """A progress bar in steps, or in thousandths of a budget of time.

    Args:
        reporter: receives the progress.
        phase: what is trained.
        budget: its length.
        position: where the run continues.
        progress: the same, from 0 to 1.
    """

    def __init__(
        self, reporter: ProgressReporter, phase: str, budget: Budget, position: Position, progress: float
    ) -> None:
        self._reporter, self._counts_steps, self._reached, self._thousandths = reporter, budget.steps is not None, 0, 0
        reporter.start(phase, budget.steps or _THOUSAND)
        self.advance(position, progress)

    def advance(self, position: Position, progress: float) -> bool:
        """Move to a position; return whether a thousandth was passed."""
        thousandths = int(progress * _THOUSAND)
        reached = position.steps if self._counts_steps else thousandths
        self._reporter.advance(reached - self._reached)
        passed = thousandths > self._thousandths
        self._reached, self._thousandths = reached, thousandths
        return passed
