"""The training loop of autoencoder and generator: steps, reports, checkpoints, interruptions."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Final

from hybridworldsim.generation.training.run_folder import GenerationOutcome, GenerationRunFolder, Trainer
from hybridworldsim.training.run.budget import Clock
from hybridworldsim.training.run.checkpoint import Position, Sums
from hybridworldsim.training.run.interruption import interruptible
from hybridworldsim.training.run.processes import ALONE, Processes
from mirror.errors import DatasetError
from mirror.progress import ProgressReporter

REPORTS: Final = 40
"""Number of rows of the curves, at equal numbers of steps."""

_SAMPLES_EVERY: Final = 10


def run_steps(
    trainer: Trainer,
    steps: int,
    folder: GenerationRunFolder,
    reporter: ProgressReporter,
    *,
    phase: str,
    checkpoint_s: float = 60.0,
    sample: Callable[[int], None] | None = None,
    processes: Processes = ALONE,
) -> Position:
    """Train to a number of steps; continue where an earlier call stopped.

    At one number of threads, interruptions do not change the result.

    Args:
        trainer: its state is restored from the checkpoint if there is one.
        steps: number of steps of the whole training.
        folder: folder of the run.
        reporter: receives the progress.
        phase: what is trained, for the progress.
        checkpoint_s: a checkpoint is written at the first step after this many seconds.
        sample: called with the number of steps at each quarter, to write samples.
        processes: those that train together. The leading one writes; Ctrl-C in one stops all after the same step.

    Returns:
        The last position.

    Raises:
        DatasetError: training diverged; the last checkpoint is kept.
        KeyboardInterrupt: after Ctrl-C, once a checkpoint is written.
    """
    position = folder.resume(trainer)
    clock, started_s, earlier_s = Clock(position.spent_s), time.monotonic(), position.wall_s
    saved_s = time.monotonic()
    reporter.start(phase, steps)
    reporter.advance(position.steps)
    with interruptible() as interrupted:
        while position.steps < steps:
            losses = trainer.step(position.steps)
            for name, loss in losses.items():
                if not math.isfinite(loss):
                    raise DatasetError(
                        f"the loss {name} is {loss} at step {position.steps}", file=folder.path,
                        expected="a finite loss", remedy="train again with a lower learning rate",
                    )  # fmt: skip
            position = replace(position, steps=position.steps + 1, sums=_add(position.sums, losses))
            reporter.advance(1)
            position = replace(position, spent_s=clock.spent_s, wall_s=earlier_s + time.monotonic() - started_s)
            if position.steps * REPORTS >= (position.reports + 1) * steps or position.steps == steps:
                position = _report(folder, position, steps, reporter, processes.leads)
                if sample is not None and processes.leads and position.rows % _SAMPLES_EVERY == 0:
                    clock.pause()
                    sample(position.steps)
                    clock.resume()
            stopped = processes.any(interrupted.is_set())
            if processes.leads and (stopped or time.monotonic() - saved_s > checkpoint_s):
                folder.save_checkpoint(trainer, position)
                saved_s = time.monotonic()
            if stopped:
                reporter.message(f"interrupted at step {position.steps}: the checkpoint is in {folder.path}")
                raise KeyboardInterrupt
    if processes.leads:
        folder.save_checkpoint(trainer, position)
    return position


def train_together(
    trainer: Trainer,
    steps: int,
    folder: GenerationRunFolder,
    reporter: ProgressReporter,
    processes: Processes,
    write: Callable[[Path], int],
    *,
    phase: str,
    loss: str,
    checkpoint_s: float,
    sample: Callable[[int], None],
) -> GenerationOutcome:
    """Train with all processes, and write the model and the outcome in the leading one.

    Args:
        trainer: as for `run_steps`, as the others that it shares.
        steps: number of steps.
        folder: folder of the run.
        reporter: receives the progress.
        processes: those that train together.
        write: writes the trained model to a path, and returns its size in bytes.
        phase: what is trained.
        loss: name of the loss in the curves.
        checkpoint_s: seconds between checkpoints.
        sample: writes samples.

    Raises:
        DatasetError: as `run_steps`, or another process stopped.
        KeyboardInterrupt: as `run_steps`.
    """
    with folder.lock() if processes.leads else nullcontext():
        position = run_steps(
            trainer, steps, folder, reporter, phase=phase, checkpoint_s=checkpoint_s, sample=sample, processes=processes
        )
        with processes.leader_first():
            if processes.leads:
                folder.finish(write, position, loss)
    done = folder.outcome
    if done is None:
        raise DatasetError("the leading process did not finish", file=folder.path, expected="an outcome")
    return done


def _report(
    folder: GenerationRunFolder, position: Position, steps: int, reporter: ProgressReporter, leads: bool
) -> Position:
    means = {name: total / count for name, (total, count) in position.sums.losses.items()}
    row = {"step": position.steps, "core_s": position.spent_s, "wall_s": position.wall_s, **means}
    if leads:
        folder.append_row(row)
    shown = ", ".join(f"{name} {mean:.5f}" for name, mean in means.items())
    left_s = position.wall_s / position.steps * (steps - position.steps)
    reporter.report(
        f"{position.steps / steps:4.0%}  step {position.steps}  {position.spent_s / 60.0:.1f} core-minutes, "
        f"{left_s / 60.0:.0f} minutes left  {shown}"
    )
    reports = position.steps * REPORTS // steps
    return replace(position, reports=reports, rows=position.rows + 1, sums=Sums())


def _add(sums: Sums, losses: dict[str, float]) -> Sums:
    added = dict(sums.losses)
    for name, value in losses.items():
        total, count = added.get(name, (0.0, 0))
        added[name] = (total + value, count + 1)
    return Sums(sums.steps + 1, sums.psnr_db, added)
