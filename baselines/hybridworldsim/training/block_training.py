"""Training of a street's block by any method: its images, one after the other, in the loop of all trainings."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hybridworldsim.trainable.method import TrainableMethod
from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.training.chart import write_chart
from hybridworldsim.training.data_loader import TrainingImageCache, stream_images
from hybridworldsim.training.documents import PREVIEWS, TrainingOutcome
from hybridworldsim.training.previews import Preview, write_previews
from hybridworldsim.training.run.budget import Budget
from hybridworldsim.training.run.curves import Row
from hybridworldsim.training.run.folder import RunFolder
from hybridworldsim.training.run.loop import train
from hybridworldsim.training.run.position import Position, Step
from hybridworldsim.training.run.training import Ending, Training
from mirror.devices import CPU
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.views.view import RenderView

_PREVIEW_EVERY: Final = 10
_LEAST_MSE: Final = 1e-10
_DIVERGED: Final = "check the poses, masks and depth of the images; the last checkpoint is unchanged"


@dataclass(frozen=True)
class Options:
    """Options of a run that do not change its result, except that previews bring a street's rows up to date.

    Attributes:
        checkpoint_s: a checkpoint is written at the first step after this many seconds.
        previews: images that are rendered during training.
        title: title of the chart.
        workers: number of threads that decode images ahead.
    """

    checkpoint_s: float = 30.0
    previews: Sequence[Preview] = ()
    title: str = "training"
    workers: int = 1


def train_block(
    trainer: TrainableMethod,
    images: TrainingImageCache,
    views: Sequence[RenderView],
    budget: Budget,
    folder: RunFolder[TrainingOutcome],
    write: Callable[[Path], int],
    *,
    seed: int = 0,
    options: Options | None = None,
    reporter: ProgressReporter | None = None,
) -> TrainingOutcome:
    """Train a block in a run folder; see `hybridworldsim.training.run.loop.train`.

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
    options = options or Options()

    def illustrate(before: Position, now: Position) -> None:
        write_chart(folder.path / "curves.svg", folder.rows, options.title)
        if now.reports // _PREVIEW_EVERY > before.reports // _PREVIEW_EVERY:
            write_previews(folder.path / PREVIEWS, options.previews, trainer, now.steps)

    with _ImageSteps(trainer, images, views, seed, options.workers) as step:
        training = Training(
            phase="training",
            budget=budget,
            trained=trainer,
            step=step,
            # Statistics for densification may be infinite.
            learned=trainer.model.named_parameters,
            describe=_describe,
            write=write,
            outcome=_outcome,
            remedy=_DIVERGED,
            after_row=illustrate,
            checkpoint_s=options.checkpoint_s,
        )
        return train(training, folder, reporter or NullProgress())


class _ImageSteps:
    """Makes a step on each image that has a pixel to learn from; a context in which threads read ahead.

    Args:
        trainer: the model.
        images: opens the images.
        views: training views.
        seed: seed of the order of the images.
        workers: number of threads that read ahead.
    """

    def __init__(
        self,
        trainer: TrainableMethod,
        images: TrainingImageCache,
        views: Sequence[RenderView],
        seed: int,
        workers: int,
    ) -> None:
        self._trainer, self._images, self._views, self._seed = trainer, images, views, seed
        self._workers = workers
        self._stream: Generator[TrainingImage, None, None] | None = None

    def __enter__(self) -> _ImageSteps:
        return self

    def __exit__(self, *_: object) -> None:
        if self._stream is not None:
            self._stream.close()

    def __call__(self, position: Position, progress: float) -> Step:
        """Train on the next image.

        Raises:
            NoSupervisionError: no image has a pixel to learn from.
            DatasetError: an image is missing or broken, or not finite.
        """
        if self._stream is None:
            self._stream = stream_images(self._images, self._views, self._seed, position.shown, self._workers)
        image, shown = next(self._stream), 1
        while not image.teaches:
            image, shown = next(self._stream), shown + 1
        if image.rgb.device.type == CPU:
            # Images on a GPU were examined before they went there.
            image.require_finite()
        report = self._trainer.step(image, progress)
        return Step(
            report.losses, psnr_db(report.losses["rgb"]), shown, {"gaussians": report.gaussians},
            image.name or str(image.viewpoint.source),
        )  # fmt: skip


def psnr_db(mean_square: float) -> float:
    """Return the PSNR for peak 1, in dB; at most 100."""
    return -10.0 * math.log10(max(mean_square, _LEAST_MSE))


def _describe(row: Row) -> str:
    return f"PSNR {row['psnr_db']:.2f} dB  loss {row['rgb']:.5f}  {row['gaussians']:.0f} Gaussians"


def _outcome(ending: Ending) -> TrainingOutcome:
    position, row = ending.position, ending.row
    return TrainingOutcome(
        steps=position.steps, skipped=position.shown - position.steps, core_s=position.spent_s,
        wall_s=position.wall_s, psnr_db=row["psnr_db"], gaussians=int(row["gaussians"]),
        model_bytes=ending.model_bytes,
    )  # fmt: skip
