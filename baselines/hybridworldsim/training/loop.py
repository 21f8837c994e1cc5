"""The training loop of all methods: reads images, writes checkpoints, curves and a model."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from torch import Tensor

from hybridworldsim.training.data_loader import TrainingImageCache, stream_images
from hybridworldsim.training.previews import Preview, write_previews
from hybridworldsim.training.run.budget import Budget, Clock
from hybridworldsim.training.run.checkpoint import Position, Sums
from hybridworldsim.training.run.folder import RunFolder, TrainingOutcome
from hybridworldsim.training.run.interruption import interruptible
from hybridworldsim.training.trainable_method import StepReport, TrainableMethod
from hybridworldsim.training.training_image import TrainingImage
from mirror.errors import DatasetError
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.views.view import RenderView

REPORTS: Final = 40
"""Number of rows of the curves, at equal steps of progress."""

_PREVIEW_EVERY: Final = 10
_THOUSAND: Final = 1000
_SMOOTHING: Final = 0.02
_LEAST_MSE: Final = 1e-10
_DIVERGED: Final = "check the poses, masks and depth of the images; the last checkpoint is unchanged"


@dataclass(frozen=True)
class Options:
    """Options of a run that do not change its result, except that previews bring the rows of a street up to date.

    Attributes:
        checkpoint_s: a checkpoint is written at the first step after this many seconds.
        previews: images that are rendered during training.
        title: title of the chart.
    """

    checkpoint_s: float = 30.0
    previews: Sequence[Preview] = ()
    title: str = "training"


def train(
    trainer: TrainableMethod,
    images: TrainingImageCache,
    views: Sequence[RenderView],
    budget: Budget,
    folder: RunFolder,
    write: Callable[[Path], int],
    *,
    seed: int = 0,
    options: Options | None = None,
    reporter: ProgressReporter | None = None,
) -> TrainingOutcome:
    """Train until the budget is spent; continue where an earlier call stopped.

    Under a budget of steps and at one number of threads, interruptions do not change the model.

    Args:
        trainer: an untrained model; its state is restored from the checkpoint if there is one.
        images: opens the images.
        views: training views, at least one.
        budget: how long to train.
        folder: folder in which the run began.
        write: writes the model to a path, and returns its size in bytes.
        seed: seed of the order of the images.
        options: see `Options`.
        reporter: receives the progress.

    Raises:
        DatasetError: an image is missing or broken, masks cover all images, or training diverged; the last checkpoint
            is kept.
        KeyboardInterrupt: after Ctrl-C, once a checkpoint is written.
    """
    options, reporter = options or Options(), reporter or NullProgress()
    position = folder.resume(trainer)
    clock, wall = Clock(position.spent_s), _WallClock(position.wall_s)
    last_checkpoint_s = time.monotonic()
    status = _Status(reporter)
    gaussians = 0
    progress = budget.progress(position.steps, position.spent_s)
    with interruptible() as interrupted, closing(stream_images(images, views, seed, position.shown)) as stream:
        while progress < 1.0:
            image = next(stream)
            position = replace(position, shown=position.shown + 1)
            if not image.scored.any():
                continue
            _require_finite_image(image)
            report = trainer.step(image, progress)
            _require_finite_losses(report, image, position.steps)
            gaussians = report.gaussians
            position = replace(position, steps=position.steps + 1, sums=_add_step(position.sums, report))
            progress = budget.progress(position.steps, clock.spent_s)
            clock.pause()
            wall.pause()
            position = replace(position, spent_s=clock.spent_s, wall_s=wall.spent_s)
            status.update(report, progress)
            if progress * REPORTS >= position.reports + 1 or progress >= 1.0:
                position = _report(folder, position, progress, gaussians, trainer, options, reporter)
            if interrupted.is_set() or time.monotonic() - last_checkpoint_s > options.checkpoint_s:
                _require_finite_parameters(trainer, position)
                folder.save_checkpoint(trainer, position)
                last_checkpoint_s = time.monotonic()
            if interrupted.is_set():
                reporter.message(f"interrupted at step {position.steps}: the checkpoint is in {folder.path}")
                raise KeyboardInterrupt
            clock.resume()
            wall.resume()
    folder.save_checkpoint(trainer, position)
    return folder.finish(write, _outcome(folder, position))


def _outcome(folder: RunFolder, position: Position) -> dict[str, float]:
    """The fields of `TrainingOutcome` that the loop knows."""
    last = folder.last
    return {
        "steps": position.steps,
        "skipped": position.shown - position.steps,
        "core_s": position.spent_s,
        "wall_s": position.wall_s,
        "psnr_db": last["psnr_db"],
        "gaussians": int(last["gaussians"]),
    }


class _Status:
    """Updates a progress bar at every thousandth of the budget, with a smoothed PSNR.

    Args:
        reporter: receives the progress.
    """

    def __init__(self, reporter: ProgressReporter) -> None:
        self._reporter = reporter
        self._reported = 0
        self._psnr_db: float | None = None
        reporter.start("training", _THOUSAND)

    def update(self, report: StepReport, progress: float) -> None:
        """Add one step."""
        psnr = psnr_db(report.losses["rgb"])
        self._psnr_db = psnr if self._psnr_db is None else self._psnr_db + _SMOOTHING * (psnr - self._psnr_db)
        reached = int(progress * _THOUSAND)
        if reached > self._reported:
            loss = report.losses["rgb"]
            self._reporter.status(f"{self._psnr_db:.2f} dB, loss {loss:.5f}, {report.gaussians} Gaussians")
            self._reporter.advance(reached - self._reported)
            self._reported = reached


def psnr_db(mean_square: float) -> float:
    """PSNR for peak 1, in dB; at most 100."""
    return -10.0 * math.log10(max(mean_square, _LEAST_MSE))


def _report(
    folder: RunFolder,
    position: Position,
    progress: float,
    gaussians: int,
    trainer: TrainableMethod,
    options: Options,
    reporter: ProgressReporter,
) -> Position:
    """Write a row of the curves, and previews at every tenth row."""
    _require_finite_parameters(trainer, position)
    sums = position.sums
    losses = {name: total / count for name, (total, count) in sums.losses.items()}
    row = {
        "step": position.steps,
        "progress": progress,
        "core_s": position.spent_s,
        "wall_s": position.wall_s,
        "psnr_db": sums.psnr_db / max(sums.steps, 1),
        "gaussians": gaussians,
        **losses,
    }
    folder.append_row(row, options.title)
    reporter.report(
        f"{progress:4.0%}  step {position.steps}  {position.spent_s / 60.0:.2f} core-minutes  "
        f"PSNR {row['psnr_db']:.2f} dB  loss {losses['rgb']:.5f}  {gaussians} Gaussians"
    )
    # A step may be longer than the time between reports.
    reports = max(int(progress * REPORTS), position.reports + 1)
    if reports // _PREVIEW_EVERY > position.reports // _PREVIEW_EVERY:
        write_previews(folder.previews, options.previews, trainer, position.steps)
    return replace(position, reports=reports, rows=position.rows + 1, sums=Sums())


def _require_finite_parameters(trainer: TrainableMethod, position: Position) -> None:
    # The rasterizer drops Gaussians that are not finite, so that no loss shows such parameters.
    for name, parameter in trainer.model.named_parameters():
        if not bool(parameter.detach().sum().isfinite()):
            raise DatasetError(
                f"{name} holds numbers that are not finite at step {position.steps}",
                expected="finite parameters", remedy=_DIVERGED,
            )  # fmt: skip


def _add_step(sums: Sums, report: StepReport) -> Sums:
    losses = dict(sums.losses)
    for name, value in report.losses.items():
        total, count = losses.get(name, (0.0, 0))
        losses[name] = (total + value, count + 1)
    return Sums(sums.steps + 1, sums.psnr_db + psnr_db(report.losses["rgb"]), losses)


def _require_finite_image(image: TrainingImage) -> None:
    # A sum is finite only if all terms are; it is the cheapest test.
    tensors: dict[str, Tensor | None] = {
        "colours": image.rgb,
        "depths": image.depth_m,
        "pose": image.viewpoint.viewmat,
        "intrinsics": image.viewpoint.K,
    }
    for what, tensor in tensors.items():
        if tensor is not None and not bool(tensor.sum().isfinite()):
            raise DatasetError(
                f"{what} that are not finite", place=image.name or str(image.viewpoint.source),
                expected="finite numbers", remedy="leave the image out, or correct its pose and depth",
            )  # fmt: skip


def _require_finite_losses(report: StepReport, image: TrainingImage, step: int) -> None:
    for name, loss in report.losses.items():
        if not math.isfinite(loss):
            raise DatasetError(
                f"the loss {name} is {loss} at step {step}", place=image.name or str(image.viewpoint.source),
                expected="a finite loss", remedy=_DIVERGED,
            )  # fmt: skip


class _WallClock:
    """Measures wall time; it can be paused as `Clock` can."""

    def __init__(self, spent_s: float) -> None:
        self.spent_s, self._since = spent_s, time.monotonic()

    def pause(self) -> None:
        self.spent_s += time.monotonic() - self._since

    def resume(self) -> None:
        self._since = time.monotonic()
