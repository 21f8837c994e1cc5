"""Trains the tiny network on datasets, in a run folder; an interrupted run continues where it stopped."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import torch

from hybridworldsim.petr.tiny.familiarity import NAME, fit_inputs, write_inputs
from hybridworldsim.petr.tiny.model_file import write_model
from hybridworldsim.petr.tiny.samples import Sample, read_sample
from hybridworldsim.petr.tiny.settings import NetworkSettings, TrainingSettings, document, training_settings
from hybridworldsim.petr.tiny.trainer import TinyTrainer
from hybridworldsim.training.run.budget import Budget, Clock
from hybridworldsim.training.run.checkpoint import Position, Sums, read_checkpoint, write_checkpoint
from hybridworldsim.training.run.curves import Row, read_curves, write_curves
from hybridworldsim.training.run.folder import MODEL, OUTCOME, begin_run, lock_run
from hybridworldsim.training.run.interruption import interruptible
from mirror.annotation.protocol import TrainingReport, TrainingTask
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, UsageError
from mirror.progress import ProgressReporter
from mirror.schema.documents import Document
from mirror.schema.files import read_json, write_json
from mirror.weights.resolve import file_sha256

_CHECKPOINT: Final = "checkpoint.safetensors"
_CURVES: Final = "curves.csv"
_REPORTS: Final = 40
_TICKS: Final = 1000
_TRAINED_ON: Final = "datasets given to `mirror annotate train`"
_CHECKPOINT_S: Final = 60.0


class AnnotatorRun(Document):
    """``run.json``: everything that determines the result of a run.

    Attributes:
        format: always ``mirror-annotator-run``.
        version: version of this document.
        annotator: name of the annotator.
        network: sizes of the network.
        training: settings of the training.
        seed: seed of all random numbers.
        steps: the budget, or None.
        core_minutes: the budget, or None.
        threads: number of torch threads; with `steps`, results repeat exactly with the same number.
        frames: number of frames.
        boxes: number of boxes.
        samples_hash: hash of the images, rays and boxes that are trained on.
    """

    format: Literal["mirror-annotator-run"] = "mirror-annotator-run"
    version: Literal["1"] = "1"
    annotator: str
    network: dict[str, Any]
    training: dict[str, Any]
    seed: int
    steps: int | None
    core_minutes: float | None
    threads: int
    frames: int
    boxes: int
    samples_hash: str


class AnnotatorOutcome(Document):
    """``outcome.json``: the result of a finished run.

    Attributes:
        steps: number of steps.
        core_s: processor time of training.
        wall_s: wall time of training.
        loss: mean loss of the last fortieth.
        model_bytes: size of ``model.safetensors``.
        sha256: its hash.
    """

    steps: int
    core_s: float
    wall_s: float
    loss: float
    model_bytes: int
    sha256: str


def read_training_samples(
    datasets: Sequence[Dataset], network: NetworkSettings, training: TrainingSettings, progress: ProgressReporter
) -> list[Sample]:
    """Read the frames of datasets that have boxes of known classes.

    Raises:
        UsageError: no frame has a box of a known class.
        DatasetError: an image, a pose or a calibration is missing or broken.
    """
    samples = []
    progress.start("reading frames", sum(len(dataset.frames()) for dataset in datasets))
    for dataset in datasets:
        for frame in dataset.frames():
            samples.append(read_sample(frame, network, training.range_m))
            progress.advance(1)
    if not any(len(sample.boxes.label) for sample in samples):
        raise UsageError(
            f"{len(samples)} frames without a box to learn from", place="--boxes",
            expected=f"boxes of cars, trucks, two-wheelers or pedestrians within {training.range_m:g} m",
        )  # fmt: skip
    return samples


def train_on_datasets(
    datasets: Sequence[Dataset], task: TrainingTask, out: Path, progress: ProgressReporter
) -> TrainingReport:
    """Train on the boxes of datasets; see `mirror.annotation.protocol.TrainableAnnotator`."""
    training = training_settings(task.settings)
    samples = read_training_samples(datasets, NetworkSettings(), training, progress)
    return train_on_samples(samples, training, task, out, progress)


def train_on_samples(
    samples: Sequence[Sample], training: TrainingSettings, task: TrainingTask, out: Path, progress: ProgressReporter
) -> TrainingReport:
    """Train on samples in memory.

    Raises:
        UsageError: the folder holds another run.
        DatasetError: training diverged; the last checkpoint is kept.
        KeyboardInterrupt: after Ctrl-C, once a checkpoint is written.
    """
    network, budget = NetworkSettings(), Budget(task.steps, task.core_minutes)
    torch.set_num_threads(task.threads)
    run = AnnotatorRun(
        annotator="petr-tiny", network=document(network), training=document(training), seed=task.seed,
        steps=task.steps, core_minutes=task.core_minutes, threads=task.threads, frames=len(samples),
        boxes=sum(len(sample.boxes.label) for sample in samples), samples_hash=_hash(samples),
    )  # fmt: skip
    outcome = _outcome(out)
    untrained = outcome is None and not any((out / name).exists() for name in (_CHECKPOINT, _CURVES))
    begin_run(out, run, finished=outcome is not None, untrained=untrained)
    if outcome is None:
        with lock_run(out):
            write_json(out / "run.json", run)
            trainer = TinyTrainer(samples, network, training, task.seed)
            position, rows = _train(trainer, budget, out, progress)
            size = write_model(out / MODEL, trainer.averaged)
            outcome = AnnotatorOutcome(
                steps=position.steps, core_s=position.spent_s, wall_s=position.wall_s, loss=rows[-1]["loss"],
                model_bytes=size, sha256=file_sha256(out / MODEL),
            )  # fmt: skip
            images = np.concatenate([sample.cameras.images for sample in samples])
            write_inputs(out / NAME, fit_inputs(images, outcome.sha256, _TRAINED_ON))
            write_json(out / OUTCOME, outcome)
    return TrainingReport(
        str(out / MODEL), run.frames, run.boxes, outcome.steps, outcome.core_s, outcome.wall_s, outcome.loss,
        outcome.model_bytes, outcome.sha256,
    )  # fmt: skip


def _outcome(out: Path) -> AnnotatorOutcome | None:
    path = out / OUTCOME
    return read_json(path, AnnotatorOutcome) if path.exists() else None


def _train(trainer: TinyTrainer, budget: Budget, out: Path, progress: ProgressReporter) -> tuple[Position, list[Row]]:
    position = Position()
    if (out / _CHECKPOINT).exists():
        state, position = read_checkpoint(out / _CHECKPOINT)
        trainer.restore(state)
    rows = read_curves(out / _CURVES, position.rows)
    clock, started_s, earlier_s = Clock(position.spent_s), time.monotonic(), position.wall_s
    saved_s, begun = started_s, position.steps
    share = budget.progress(position.steps, position.spent_s)
    progress.start("training", _TICKS)
    progress.advance(int(share * _TICKS))
    with interruptible() as interrupted:
        while share < 1.0:
            losses = trainer.step(position.steps, share)
            for name, loss in losses.items():
                if not math.isfinite(loss):
                    raise DatasetError(
                        f"the loss {name} is {loss} at step {position.steps}", file=out, expected="a finite loss",
                        remedy="train again in another folder with --set learning_rate=0.0005",
                    )  # fmt: skip
            position = replace(
                position, steps=position.steps + 1, sums=_add(position.sums, losses), spent_s=clock.spent_s,
                wall_s=earlier_s + time.monotonic() - started_s,
            )  # fmt: skip
            before, share = share, budget.progress(position.steps, position.spent_s)
            progress.advance(int(share * _TICKS) - int(before * _TICKS))
            if int(share * _REPORTS) > position.reports:
                position = _report(position, share, begun, time.monotonic() - started_s, rows, out, progress)
            if interrupted.is_set() or time.monotonic() - saved_s > _CHECKPOINT_S:
                write_checkpoint(out / _CHECKPOINT, trainer.state(), position)
                saved_s = time.monotonic()
            if interrupted.is_set():
                progress.message(f"interrupted at step {position.steps}: the checkpoint is in {out}")
                raise KeyboardInterrupt
    write_checkpoint(out / _CHECKPOINT, trainer.state(), position)
    return position, rows


def _report(
    position: Position, share: float, begun: int, here_s: float, rows: list[Row], out: Path, progress: ProgressReporter
) -> Position:
    means = {name: total / count for name, (total, count) in position.sums.losses.items()}
    rows.append(
        {"step": position.steps, "progress": share, "core_s": position.spent_s, "wall_s": position.wall_s, **means}
    )
    write_curves(out / _CURVES, rows)
    left_s = here_s / max(position.steps - begun, 1) * position.steps * (1.0 - share) / share
    progress.report(
        f"{share:4.0%}  step {position.steps}  {position.spent_s / 60.0:.1f} core-minutes, "
        f"{left_s / 60.0:.0f} minutes left  loss {means['loss']:.3f}"
    )
    return replace(position, reports=int(share * _REPORTS), rows=len(rows), sums=Sums())


def _add(sums: Sums, losses: dict[str, float]) -> Sums:
    added = dict(sums.losses)
    for name, value in losses.items():
        total, count = added.get(name, (0.0, 0))
        added[name] = (total + value, count + 1)
    return Sums(sums.steps + 1, sums.psnr_db, added)


def _hash(samples: Sequence[Sample]) -> str:
    digest = hashlib.sha256()
    for sample in samples:
        for part in (sample.cameras, sample.boxes):
            for name, values in vars(part).items():
                digest.update(f"{name} {values.shape} {values.dtype}".encode())
                digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()
