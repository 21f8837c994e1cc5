"""The training loop of autoencoder and generator: steps, reports, checkpoints, interruptions."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from hybridworldsim.generation.training.run_folder import GenerationRunFolder, Trainer
from hybridworldsim.training.budget import Clock
from hybridworldsim.training.interruption import interruptible
from hybridworldsim.training.run.checkpoint import Position, Sums
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
    leads: bool = True,
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
        leads: whether this process writes; of several processes one does.

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
                position = _report(folder, position, steps, reporter, leads)
                if sample is not None and leads and position.rows % _SAMPLES_EVERY == 0:
                    clock.pause()
                    sample(position.steps)
                    clock.resume()
            if leads and (interrupted.is_set() or time.monotonic() - saved_s > checkpoint_s):
                folder.save_checkpoint(trainer, position)
                saved_s = time.monotonic()
            if interrupted.is_set():
                reporter.message(f"interrupted at step {position.steps}: the checkpoint is in {folder.path}")
                raise KeyboardInterrupt
    if leads:
        folder.save_checkpoint(trainer, position)
    return position


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
