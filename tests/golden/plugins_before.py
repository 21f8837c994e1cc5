"""Plug-ins of another package, one of each kind, as they were written for MIRROR 0.1.0. The file is never changed.

`tests.golden.test_plugins` packs this file into a wheel. It imports what a package may import: names that `__all__` of
a package lists, and the modules of the protocols that plug-ins implement.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hybridworldsim.simulator import Controls, Observation, ObservationSpec
from hybridworldsim.simulator.policies.protocol import Action, NoPlanYet
from mirror import Dataset, Frame
from mirror.annotation import Detections
from mirror.annotation.descriptions import Description
from mirror.annotation.protocol import require_settings
from mirror.command import Command
from mirror.errors import RecordingError
from mirror.methods import AppearancePolicy, ReconstructionResult, ReconstructionTask, RenderView
from mirror.methods.plugin import InstalledMethod
from mirror.privacy import DetectorKind, DetectorOptions, Region
from mirror.recordings import CALIBRATIONS, DriveInfo, FileStream, Recording, Track
from mirror.recordings.protocol import Reader

PROTOCOLS = (InstalledMethod, Reader, Recording, NoPlanYet, Region)
ENTRY_POINTS = {
    "mirror.recordings": ("walk_before", "WalkReader"),
    "mirror.methods": ("grey_before", "METHOD"),
    "mirror.detectors": ("dark_before", "DETECTOR"),
    "mirror.annotators": ("car_before", "ANNOTATOR"),
    "mirror.describers": ("words_before", "DESCRIBER"),
    "mirror.policies": ("coast_before", "Coast"),
    "mirror.weather": ("fog_before", "find_weather"),
    "mirror.commands": ("verb_before", "COMMAND"),
}


@dataclass(frozen=True)
class Walk:
    path: Path
    rig: None = None

    @property
    def info(self) -> DriveInfo:
        return DriveInfo(self.path.stem, vehicle_id="walker", vehicle_type="unknown", time_base="Unix seconds")

    def files(self) -> Sequence[tuple[str, Path | str]]:
        return [(self.path.name, self.path)]

    def track(self) -> Track:
        rows = [json.loads(line) for line in self.path.read_text().splitlines()]
        if not rows:
            raise RecordingError("no rows", file=self.path)
        seconds, longitude, latitude = np.array([[row[key] for key in ("t", "lon", "lat")] for row in rows]).T
        return Track((seconds * 1e9).astype(np.int64), longitude, latitude, file=self.path)

    def calibrations(self) -> Any:
        return CALIBRATIONS.schema.empty_table()

    def images(self) -> Mapping[str, FileStream]:
        return {}

    def boxes(self) -> None:
        return None


class WalkReader:
    name = "walk_before"
    expects = "a .walk file: one JSON object a line, with t, lon and lat"

    def recognises(self, path: Path) -> bool:
        return path.suffix == ".walk"

    def open(self, path: Path, options: Mapping[str, str]) -> Walk:
        return Walk(path)


class Grey:
    def reconstruct(self, dataset: Dataset, task: ReconstructionTask, out: Path, progress: Any) -> ReconstructionResult:
        (out / "grey.txt").write_text("128")
        return ReconstructionResult(out)

    def open(self, model: Path, appearance: AppearancePolicy) -> Callable[[RenderView], Any]:
        return lambda view: np.full((view.height_px, view.width_px, 3), 128, np.uint8)


class Dark:
    kind, name, version, weights_sha256 = "face", "dark_before", "1", ""

    def __init__(self, options: DetectorOptions) -> None:
        self.threshold = 0.5 if options.threshold is None else options.threshold

    def __call__(self, image: Any) -> list[Region]:
        return []


class Cars:
    name, version, fingerprint = "car_before", "1", "car_before 1"

    def annotate(self, frame: Frame) -> Detections:
        return Detections.empty(frame.timestamp_ns)

    def close(self) -> None:
        pass


class InstalledCars:
    settings: Mapping[str, str] = {}

    def open(self, dataset: Dataset, settings: Mapping[str, str], device: str) -> Cars:
        require_settings("car_before", settings, self.settings)
        return Cars()


class Words:
    fingerprint = "words 1"

    def describe(self, frame: Frame) -> Description:
        return Description("a street", "day")

    def close(self) -> None:
        pass


class InstalledWords:
    settings: Mapping[str, str] = {}

    def open(self, dataset: Dataset, settings: Mapping[str, str], device: str) -> Words:
        return Words()


class Coast:
    cameras = ()
    privileged = False

    def reset(self, spec: ObservationSpec) -> None:
        pass

    def act(self, observation: Observation) -> Action:
        return Controls(0.0, 0.0)

    def close(self) -> None:
        pass


def find_weather(images: list[Any]) -> str:
    return "fog"


def main(argv: Sequence[str]) -> int:
    print("the verb was called with", *argv)
    return 0


METHOD = Grey()
DETECTOR = DetectorKind("face", "finds nothing", Dark)
ANNOTATOR = InstalledCars()
DESCRIBER = InstalledWords()
COMMAND = Command("data", "a verb of another package", "plugins_before")
