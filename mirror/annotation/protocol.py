"""The interface of annotators: what a package offers under the entry points ``mirror.annotators``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from mirror.annotation.detections import Detections
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.progress import ProgressReporter


class Annotator(Protocol):
    """A plug-in that finds the road users of a frame.

    Attributes:
        name: source of the layers that it makes, such as ``petr``.
        version: default version of the source.
        fingerprint: identifies all that its results depend on apart from the frames: weights, settings, files. A run
            that is resumed with another fingerprint begins again.

    A resumed run takes the finished frames whose images have the same bytes. An annotator that opens no image may have
    an attribute ``reads_images = False``; then no image is read for that comparison. An annotator that knows its
    training data may have an attribute ``trained_on`` with a few words, such as ``synthetic streets``: the output, the
    layer and the report state them, with the frames that it returns as `Detections.unfamiliar`.
    """

    name: str
    version: str
    fingerprint: str

    def annotate(self, frame: Frame) -> Detections:
        """Find the road users of one frame: the images of all cameras at one instant.

        Raises:
            MirrorError: there is no valid result for this frame; the run notes it and goes on.
        """

    def close(self) -> None:
        """Release the annotator's processes and devices."""


class InstalledAnnotator(Protocol):
    """The object that an entry point ``mirror.annotators`` names."""

    settings: Mapping[str, str]
    """The settings that `open` accepts, each with one line of help."""

    def open(self, dataset: Dataset, settings: Mapping[str, str], device: str) -> Annotator:
        """Open the annotator, ready to annotate.

        Args:
            dataset: the dataset, or the view, to be annotated.
            settings: values of the settings, as text.
            device: a torch device, such as ``cpu`` or ``cuda:0``. An annotator whose attribute `takes_device` is False
                always gets ``cpu``.

        Raises:
            UsageError: a setting is unknown or invalid.
        """


def takes_device(installed: object) -> bool:
    """Return whether an annotator or describer computes on a device: True unless its `takes_device` is False."""
    return bool(getattr(installed, "takes_device", True))


@dataclass(frozen=True)
class TrainingTask:
    """The task of training an annotator: its length, seed, threads and settings.

    Attributes:
        steps: number of steps; the result repeats exactly with the same number of threads. Excludes `core_minutes`.
        core_minutes: processor time of training, summed over threads.
        seed: seed of all random numbers.
        threads: number of threads.
        settings: settings of the training, as text by name.
    """

    steps: int | None
    core_minutes: float | None
    seed: int
    threads: int
    settings: Mapping[str, str]


@dataclass(frozen=True)
class TrainingReport:
    """The result of a finished training of an annotator.

    Attributes:
        model: file of the trained model.
        frames: number of frames of the datasets.
        boxes: number of boxes in them.
        steps: steps.
        core_s: processor time of training.
        wall_s: wall time of training.
        loss: mean loss of the last fortieth.
        model_bytes: size of the file.
        sha256: hash of the file.
    """

    model: str
    frames: int
    boxes: int
    steps: int
    core_s: float
    wall_s: float
    loss: float
    model_bytes: int
    sha256: str


@runtime_checkable
class TrainableAnnotator(Protocol):
    """An installed annotator that can also be trained: ``mirror annotate train``."""

    def train(
        self, datasets: Sequence[Dataset], task: TrainingTask, out: Path, progress: ProgressReporter
    ) -> TrainingReport:
        """Train on the boxes of datasets; an interrupted run continues in the same folder.

        Args:
            datasets: views with images and one chosen layer of boxes.
            task: how long and how.
            out: folder of the run: ``run.json``, ``curves.csv``, a checkpoint, ``model.safetensors``, ``outcome.json``.
            progress: receives the progress.

        Raises:
            UsageError: a setting is invalid, there are no boxes to learn from, or the folder holds another run.
            DatasetError: an image is missing or broken, or training diverged.
            KeyboardInterrupt: after Ctrl-C, once a checkpoint is written.
        """


def require_settings(name: str, given: Mapping[str, str], known: Mapping[str, str]) -> None:
    """Refuse unknown settings.

    Raises:
        UsageError: a setting is unknown; the known ones are listed.
    """
    from mirror.errors import UsageError

    unknown = sorted(set(given) - set(known))
    if unknown:
        listed = ", ".join(known) or "no settings"
        raise UsageError(f"annotator {name} has no setting {unknown[0]!r}", place="--set", expected=listed)


def share_setting(settings: Mapping[str, str], name: str, default: float) -> float:
    """Return the value of a setting that is a number from 0 to below 1.

    Raises:
        UsageError: it is another value.
    """
    from mirror.errors import UsageError

    text = settings.get(name, str(default))
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 1.0:
        raise UsageError(text, place=f"--set {name}", expected="a number from 0 to below 1")
    return value
