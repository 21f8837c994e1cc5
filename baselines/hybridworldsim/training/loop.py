"""The loop that trains every method: images in, checkpoints, curves and a model out."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Final

from torch import Tensor

from hybridworldsim.training.budget import Budget, Clock
from hybridworldsim.training.data_loader import TrainingImageCache, stream
from hybridworldsim.training.run.checkpoint import Position, Sums
from hybridworldsim.training.run.folder import RunFolder, TrainingOutcome
from hybridworldsim.training.run.previews import Preview, write_previews
from hybridworldsim.training.trainable_method import StepReport, TrainableMethod
from hybridworldsim.training.training_image import TrainingImage
from mirror.errors import DatasetError
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.views.view import RenderView

REPORTS: Final = 40
"""Rows of the curves, at equal steps of progress."""

_PICTURES_EVERY: Final = 10
_THOUSAND: Final = 1000
_LIVE: Final = 0.02
_LEAST_MSE: Final = 1e-10
_DIVERGED: Final = "look at the poses, masks and depth of the images; the last checkpoint stays as it is"


@dataclass(frozen=True)
class Options:
    """How a run is looked after. But for the specimens, before which a street catches up, nothing of it shows after.

    Attributes:
        checkpoint_s: a checkpoint is written at the first step after so many seconds.
        specimens: images that are rendered as training goes on.
        title: of the chart.
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
    watch: ProgressReporter | None = None,
) -> TrainingOutcome:
    """Train until the budget is spent; go on where an earlier call stopped.

    Under a budget of steps and at one number of threads the model is the same however often it was interrupted.

    Args:
        trainer: as it begins; it is taken to the checkpoint if there is one.
        images: opens them.
        views: what is trained on, at least one.
        budget: how long.
        folder: that the run began in.
        write: writes what was learnt to a path, and says how many bytes it has.
        seed: of the order of the images.
        options: see `Options`.
        watch: told how it goes.

    Raises:
        DatasetError: an image is missing or broken, masks cover every one of them, or training came to numbers that
            are none; the last checkpoint stays.
        KeyboardInterrupt: after Ctrl-C, once a checkpoint is written.
    """
    options, watch = options or Options(), watch or NullProgress()
    position = folder.resume(trainer)
    clock, wall = Clock(position.spent_s), _Wall(position.wall_s)
    kept = time.monotonic()
    watch.start("training", _THOUSAND)
    network_inputs = 0
    live: float | None = None
    gaussians = 0
    progress = budget.progress(position.steps, position.spent_s)
    with _interruptible() as interrupted, closing(stream(images, views, seed, position.shown)) as coming:
        while progress < 1.0:
            image = next(coming)
            position = replace(position, shown=position.shown + 1)
            if not image.scored.any():
                continue
            _require_numbers(image)
            report = trainer.step(image, progress)
            _require_learnt(report, image, position.steps)
            gaussians = report.gaussians
            psnr = psnr_of(report.losses["rgb"])
            live = psnr if live is None else live + _LIVE * (psnr - live)
            position = replace(position, steps=position.steps + 1, sums=_added(position.sums, report, psnr))
            progress = budget.progress(position.steps, clock.spent_s)
            clock.pause()
            wall.pause()
            position = replace(position, spent_s=clock.spent_s, wall_s=wall.spent_s)
            if int(progress * _THOUSAND) > network_inputs:
                watch.status(f"{live:.2f} dB, loss {report.losses['rgb']:.5f}, {gaussians} Gaussians")
                watch.advance(int(progress * _THOUSAND) - network_inputs)
                network_inputs = int(progress * _THOUSAND)
            if progress * REPORTS >= position.reports + 1 or progress >= 1.0:
                position = _report(folder, position, progress, gaussians, trainer, options, watch)
            if interrupted.is_set() or time.monotonic() - kept > options.checkpoint_s:
                _require_sound(trainer, position)
                folder.save_checkpoint(trainer, position)
                kept = time.monotonic()
            if interrupted.is_set():
                watch.message(f"interrupted at step {position.steps}: the checkpoint is in {folder.path}")
                raise KeyboardInterrupt
            clock.resume()
            wall.resume()
    folder.save_checkpoint(trainer, position)
    last = folder.last
    outcome = {
        "steps": position.steps,
        "skipped": position.shown - position.steps,
        "core_s": position.spent_s,
        "wall_s": position.wall_s,
        "psnr_db": last["psnr_db"],
        "gaussians": int(last["gaussians"]),
    }
    return folder.finish(write, outcome)


def psnr_of(mean_square: float) -> float:
    """PSNR, peak 1, in dB; not above 100."""
    return -10.0 * math.log10(max(mean_square, _LEAST_MSE))


def _report(
    folder: RunFolder,
    position: Position,
    progress: float,
    gaussians: int,
    trainer: TrainableMethod,
    options: Options,
    watch: ProgressReporter,
) -> Position:
    """Write a row of the curves, and images at every so many-th."""
    _require_sound(trainer, position)
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
    watch.report(
        f"{progress:4.0%}  step {position.steps}  {position.spent_s / 60.0:.2f} core-minutes  "
        f"PSNR {row['psnr_db']:.2f} dB  loss {losses['rgb']:.5f}  {gaussians} Gaussians"
    )
    # A step may be longer than the time between reports.
    reports = max(int(progress * REPORTS), position.reports + 1)
    if reports // _PICTURES_EVERY > position.reports // _PICTURES_EVERY:
        write_previews(folder.pictures, options.previews, trainer, position.steps)
    return replace(position, reports=reports, rows=position.rows + 1, sums=Sums())


def _require_sound(trainer: TrainableMethod, position: Position) -> None:
    # The rasterizer leaves out what has no place, so that no loss tells of such parameters.
    for name, parameter in trainer.model.named_parameters():
        if not bool(parameter.detach().sum().isfinite()):
            raise DatasetError(
                f"{name} holds numbers that are none at step {position.steps}",
                expected="finite parameters", remedy=_DIVERGED,
            )  # fmt: skip


def _added(sums: Sums, report: StepReport, psnr: float) -> Sums:
    losses = dict(sums.losses)
    for name, value in report.losses.items():
        total, count = losses.get(name, (0.0, 0))
        losses[name] = (total + value, count + 1)
    return Sums(sums.steps + 1, sums.psnr_db + psnr, losses)


def _require_numbers(image: TrainingImage) -> None:
    # A sum is finite only if all of it is, and the cheapest to ask.
    tensors: dict[str, Tensor | None] = {
        "colours": image.rgb,
        "depths": image.depth_m,
        "pose": image.viewpoint.viewmat,
        "intrinsics": image.viewpoint.K,
    }
    for what, tensor in tensors.items():
        if tensor is not None and not bool(tensor.sum().isfinite()):
            raise DatasetError(
                f"{what} that are no finite numbers", place=image.name or str(image.viewpoint.source),
                expected="an image of finite numbers", remedy="leave the image out, or correct its pose and depth",
            )  # fmt: skip


def _require_learnt(report: StepReport, image: TrainingImage, step: int) -> None:
    for name, loss in report.losses.items():
        if not math.isfinite(loss):
            raise DatasetError(
                f"the loss {name} is {loss} at step {step}", place=image.name or str(image.viewpoint.source),
                expected="a finite loss", remedy=_DIVERGED,
            )  # fmt: skip


class _Wall:
    """Time on the wall, that can be stopped as `Clock` can."""

    def __init__(self, spent_s: float) -> None:
        self.spent_s, self._since = spent_s, time.monotonic()

    def pause(self) -> None:
        self.spent_s += time.monotonic() - self._since

    def resume(self) -> None:
        self._since = time.monotonic()


@contextmanager
def _interruptible() -> Iterator[threading.Event]:
    """Ctrl-C is heard between steps, since half a step is no state to keep; a second one at once."""
    interrupted = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield interrupted
        return
    before = signal.getsignal(signal.SIGINT)
    if before == signal.SIG_IGN:
        # In the background of a script that is how it is meant.
        yield interrupted
        return

    def on_signal(number: int, frame: FrameType | None) -> None:
        if interrupted.is_set():
            raise KeyboardInterrupt
        interrupted.set()

    signal.signal(signal.SIGINT, on_signal)
    try:
        yield interrupted
    finally:
        signal.signal(signal.SIGINT, before)
