"""Trains the tiny network on datasets, in a run folder; an interrupted run continues where it stopped."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import torch

from hybridworldsim.petr.tiny.familiarity import NAME, fit_inputs, write_inputs
from hybridworldsim.petr.tiny.model_file import write_model
from hybridworldsim.petr.tiny.samples import Sample, read_sample
from hybridworldsim.petr.tiny.settings import NetworkSettings, TrainingSettings, document, training_settings
from hybridworldsim.petr.tiny.trainer import TinyTrainer
from hybridworldsim.training.run.budget import Budget
from hybridworldsim.training.run.folder import RunFolder
from hybridworldsim.training.run.loop import train
from hybridworldsim.training.run.position import Position, Step
from hybridworldsim.training.run.training import Ending, Training
from mirror.annotation.protocol import TrainingReport, TrainingTask
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.progress import ProgressReporter
from mirror.schema.documents import Document
from mirror.weights.resolve import file_sha256

_TRAINED_ON: Final = "datasets given to `mirror annotate train`"


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
    folder = RunFolder(out, AnnotatorOutcome)
    outcome = folder.begin(run)
    if outcome is None:
        with folder.claim(run):
            trainer = TinyTrainer(samples, network, training, task.seed)
            outcome = train(_training(trainer, samples, budget, folder), folder, progress)
    return TrainingReport(
        str(folder.model), run.frames, run.boxes, outcome.steps, outcome.core_s, outcome.wall_s, outcome.loss,
        outcome.model_bytes, outcome.sha256,
    )  # fmt: skip


def _training(
    trainer: TinyTrainer, samples: Sequence[Sample], budget: Budget, folder: RunFolder[AnnotatorOutcome]
) -> Training[AnnotatorOutcome]:
    def step(position: Position, progress: float) -> Step:
        return Step(trainer.step(position.steps, progress))

    def outcome(ending: Ending) -> AnnotatorOutcome:
        position, sha256 = ending.position, file_sha256(folder.model)
        images = np.concatenate([sample.cameras.images for sample in samples])
        write_inputs(folder.path / NAME, fit_inputs(images, sha256, _TRAINED_ON))
        return AnnotatorOutcome(
            steps=position.steps, core_s=position.spent_s, wall_s=position.wall_s, loss=ending.row["loss"],
            model_bytes=ending.model_bytes, sha256=sha256,
        )  # fmt: skip

    return Training(
        phase="training",
        budget=budget,
        trained=trainer,
        step=step,
        learned=lambda: trainer.state().items(),
        describe=lambda row: f"loss {row['loss']:.3f}",
        write=lambda file: write_model(file, trainer.averaged),
        outcome=outcome,
        remedy="train again in another folder with --set learning_rate=0.0005",
    )


def _hash(samples: Sequence[Sample]) -> str:
    digest = hashlib.sha256()
    for sample in samples:
        for part in (sample.cameras, sample.boxes):
            for name, values in vars(part).items():
                digest.update(f"{name} {values.shape} {values.dtype}".encode())
                digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()
