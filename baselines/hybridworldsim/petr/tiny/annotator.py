"""The annotator ``petr-tiny``: a network that ships with the package, or one of ``mirror annotate train``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Final

import numpy as np

from hybridworldsim.petr.tiny.detect import find_boxes
from hybridworldsim.petr.tiny.familiarity import NAME, FamiliarInputs, read_inputs
from hybridworldsim.petr.tiny.model_file import read_model
from hybridworldsim.petr.tiny.network import TinyPetr
from hybridworldsim.petr.tiny.samples import camera_input
from hybridworldsim.petr.tiny.settings import CLASSES
from mirror.annotation.detections import Detections
from mirror.annotation.protocol import Annotator, TrainingReport, TrainingTask, require_settings, share_setting
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.devices import resolve_device
from mirror.geometry.poses import Poses
from mirror.progress import ProgressReporter
from mirror.schema.finished_work import hash_values

SHIPPED: Final = Path(str(files("hybridworldsim.petr.tiny") / "weights" / "petr_tiny.safetensors"))
SHIPPED_SHA256: Final = "f66508bce56b92dda7fba82989b7c50343eed9947e87e5969cba8c0cb444a9fc"
_SETTINGS: Final = {
    "weights": "model.safetensors of `mirror annotate train`; by default the network that is installed",
    "sha256": "its hash; a file with another one is refused",
    "min_score": "boxes with a lower score are left out, 0.3 by default",
}


class TinyAnnotator:
    """An annotator that runs a network on one frame after the other.

    Args:
        network: the network, in evaluation mode.
        sha256: hash of its file.
        device: torch device.
        min_score: least score of a box.
        inputs: what its training images look like; None: unknown.
    """

    def __init__(
        self, network: TinyPetr, sha256: str, device: str, min_score: float, inputs: FamiliarInputs | None = None
    ) -> None:
        self.name, self.version = "petr-tiny", sha256[:8]
        known = "" if inputs is None else f" {hash_values(inputs.model_dump(mode='json'))}"
        self.fingerprint = f"petr-tiny {sha256} {min_score}{known}"
        self.trained_on = None if inputs is None else inputs.trained_on
        self._inputs = inputs
        self._network, self._min_score = network.to(device), min_score

    def annotate(self, frame: Frame) -> Detections:
        """Find the boxes of one frame. Velocities are unknown: `mirror annotate track` estimates them."""
        cameras = camera_input(frame, self._network.settings)
        boxes = find_boxes(self._network, cameras, min_score=self._min_score)
        count = len(boxes.score)
        # Cameras vote: one that is covered or blinded does not decide.
        unfamiliar = self._inputs is not None and bool(self._inputs.are_unfamiliar(cameras.images).mean() > 0.5)
        if not count:
            return replace(Detections.empty(frame.timestamp_ns), unfamiliar=unfamiliar)
        half = 0.5 * boxes.yaw_rad.double().cpu().numpy()
        zero = np.zeros(count)
        return Detections(
            frame.timestamp_ns,
            Poses(np.stack((np.cos(half), zero, zero, np.sin(half)), axis=1), boxes.centre_m.double().cpu().numpy()),
            boxes.size_m.double().cpu().numpy(),
            np.full((count, 3), np.nan),
            tuple(CLASSES[label] for label in boxes.label.tolist()),
            boxes.score.double().cpu().numpy(),
            unfamiliar=unfamiliar,
        )

    def close(self) -> None:
        """Do nothing: only memory is held."""


class _Installed:
    settings: Mapping[str, str] = _SETTINGS

    def open(self, dataset: Dataset, settings: Mapping[str, str], device: str) -> Annotator:
        """Read the network, and check device and settings."""
        require_settings("petr-tiny", settings, self.settings)
        device = resolve_device(device).name
        given = settings.get("weights")
        expected = settings.get("sha256") or (None if given else SHIPPED_SHA256)
        path = Path(given) if given else SHIPPED
        network, digest = read_model(path, sha256=expected)
        inputs = read_inputs(path.with_name(NAME), digest)
        return TinyAnnotator(network, digest, device, share_setting(settings, "min_score", 0.3), inputs)

    def train(
        self, datasets: Sequence[Dataset], task: TrainingTask, out: Path, progress: ProgressReporter
    ) -> TrainingReport:
        """Train a network on the boxes of datasets."""
        from hybridworldsim.petr.tiny.run import train_on_datasets

        return train_on_datasets(datasets, task, out, progress)


ANNOTATOR: Final = _Installed()
