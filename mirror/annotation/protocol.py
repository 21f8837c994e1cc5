"""The interface of annotators: what a package offers under the entry points ``mirror.annotators``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from mirror.annotation.detections import Detections
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.progress import ProgressReporter


class Annotator(Protocol):
    """Finds the road users of a frame.

    Attributes:
        name: source of the layers that it makes, such as ``petr``.
        version: default version of the source.
        fingerprint: identifies all that its results depend on apart from the frames: weights, settings, files. A run
            that is resumed with another fingerprint begins again.
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
        """Release what the annotator holds: processes, devices."""


class InstalledAnnotator(Protocol):
    """The object that an entry point ``mirror.annotators`` names."""

    settings: Mapping[str, str]
    """The settings that `open` accepts, each with one line of help."""

    def open(self, dataset: Dataset, settings: Mapping[str, str], device: str) -> Annotator:
        """Make the annotator ready.

        Args:
            dataset: the dataset, or the view, to be annotated.
            settings: values of the settings, as text.
            device: a torch device, such as ``cpu`` or ``cuda``; annotators that need none ignore it.

        Raises:
            UsageError: a setting is unknown or invalid.
        """


@runtime_checkable
class TrainableAnnotator(Protocol):
    """An installed annotator that can also be trained: ``mirror annotate train``."""

    def train(
        self, datasets: tuple[Dataset, ...], task: Mapping[str, Any], out: Path, progress: ProgressReporter
    ) -> Mapping[str, Any]:
        """Train on the boxes of datasets; an interrupted run continues in the same folder.

        Args:
            datasets: views with images and one chosen layer of boxes.
            task: ``steps`` or ``core_minutes``, ``seed``, and ``settings`` as text by name.
            out: folder of the run.
            progress: receives the progress.

        Returns:
            Figures of the run for the report, by name.
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
