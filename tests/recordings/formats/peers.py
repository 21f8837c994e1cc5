"""The inputs of other toolkits that read the same files as our readers; ``tests/peers`` holds what they read."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.recordings.formats.argoverse2 import write_argoverse2
from tests.recordings.formats.nuscenes import write_nuscenes
from tests.recordings.formats.street import StreetDrive, synth_drives

RESULTS = Path(__file__).resolve().parents[2] / "peers"
CAMERAS = ("front_wide", "front_left", "rear_right")


def peer_drive(offset_m: tuple[float, float, float]) -> StreetDrive:
    """The drive that toolkits read."""
    return synth_drives()[0].placed(offset_m).with_cameras(CAMERAS)


def nuscenes_input(folder: Path) -> Path:
    """A folder with one scene, in a map of no known place."""
    shutil.rmtree(folder, ignore_errors=True)
    return write_nuscenes(folder, [peer_drive((1620.0, 1180.0, 0.0))], location="synthetic-street")


def argoverse2_input(folder: Path) -> Path:
    """A folder with one log in Pittsburgh."""
    shutil.rmtree(folder, ignore_errors=True)
    return write_argoverse2(folder, peer_drive((5122.0, 2432.0, 66.0)))


INPUTS: dict[str, Callable[[Path], Path]] = {"nuscenes": nuscenes_input, "argoverse2": argoverse2_input}


def result(name: str) -> Any:
    """What a toolkit read."""
    return json.loads((RESULTS / name / "result.json").read_text())
