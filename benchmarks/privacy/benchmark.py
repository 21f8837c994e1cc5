"""De-identification: recall of faces and plates, what is covered beside them, the template attack, and run time.

``python -m benchmarks privacy [--sections recall boxes attack control time] [--lights day-clear ...] [--images N]
[--near N]`` on the synthetic street, by light. A region counts if 90 % of it are covered; faces need 60 % of their
front visible, plates 85 %. The images of a light show people and cars as in ``synth_detectors``; further ones show cars
at 4.5 to 11 m, for the recall of plates only. Recall is by image: nothing is propagated, but for the rows with
fallback, which use the vehicles' exact 3D boxes; ``boxes`` disturbs these boxes, in the images of all chosen lights.
What detectors found is appended to ``benchmarks/out/privacy_recall_*.jsonl``; an interrupted run goes on there, and
larger numbers add images to it. After a change of the synthetic street, delete these files. YuNet is in the folder of
real recordings (``MIRROR_REAL_DATA``); plates are found by ``world_plates``. `mirror weights fetch clp_det` gets the
detector that is timed beside them. Each section, and each light of the first, has a report of its own.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from benchmarks.privacy.attack import CHANCE, mosaic, read_plates, redacting
from benchmarks.privacy.box_errors import box_error_rows
from benchmarks.privacy.outcomes import Outcome, append_outcome, read_outcomes, search_image, settings_digest
from benchmarks.privacy.recall import Tally
from benchmarks.report import OUT, Row, report
from benchmarks.synth_detectors.benchmark import face_weights
from benchmarks.synth_detectors.crowd import build_street, make_condition, render_crowds
from mirror.errors import ExitCode
from mirror.privacy.detectors.faces import YuNet
from mirror.privacy.detectors.plates import ChinesePlates
from mirror.privacy.detectors.protocol import Detector, DetectorOptions
from mirror.privacy.detectors.world_plates import WorldPlates
from mirror.privacy.operators import Redaction
from mirror.synth.light.condition import Condition
from mirror.synth.street.world import World

CONDITIONS: Final = (("day", "clear"), ("night", "clear"), ("dusk", "clear"), ("day", "rain"))
SECTIONS: Final = ("recall", "boxes", "attack", "control", "time")
_WIDTH_PX: Final = 960
_AT_ONCE: Final = 10
_SEED: Final = 31
_NEAR: Final[Mapping[str, Any]] = {"people": (0, 0), "cars": (4, 4), "cars_m": (4.5, 11.0)}
SERIES: Final[Mapping[str, tuple[int, Mapping[str, Any]]]] = {"street": (_SEED, {}), "near": (_SEED + 1, _NEAR)}
"""Seed of each series of images, and what is placed in them."""
_ATTACK_PX: Final = 64
_ATTACK_MARGIN: Final = 0.05
_CONTROL: Final = 0.5
_YUNET_MS: Final = 50.0
_WORLD_PLATES_MS: Final = 120.0


def search_lights(
    conditions: Sequence[tuple[str, str]], counts: Mapping[str, int], detectors: Mapping[str, Sequence[Detector]]
) -> dict[tuple[str, str], dict[str, list[Outcome]]]:
    """Search the images that the files of the lights lack, and return the outcomes by light and series.

    The lights take turns: what an interruption leaves is about as much of each.

    Args:
        conditions: light and weather.
        counts: number of images of each series.
        detectors: the detectors of each series.
    """
    world = build_street()
    found: dict[tuple[str, str], dict[str, list[Outcome]]] = {one: {} for one in conditions}
    for series, count in counts.items():
        for upto in [*range(_AT_ONCE, count, _AT_ONCE), count]:
            for light, weather in conditions:
                file = OUT / f"privacy_recall_{light}_{weather}.jsonl"
                condition = make_condition(light, weather)
                found[light, weather][series] = search_images(file, world, condition, series, upto, detectors[series])
            print(f"{series}: {upto} images of each light", file=sys.stderr, flush=True)
    return found


def search_images(
    file: Path, world: World, condition: Condition, series: str, count: int, detectors: Sequence[Detector]
) -> list[Outcome]:
    """Search the images of a series that a file lacks, append the results, and return all of the series.

    Args:
        file: the outcomes of a light.
        world: the street.
        condition: light and weather.
        series: `street`: people and cars; `near`: cars at 4.5 to 11 m.
        count: number of images.
        detectors: the detectors.
    """
    seed, placed = SERIES[series]
    known = [one for one in read_outcomes(file, settings_digest(detectors)) if (one.series, one.seed) == (series, seed)]
    done = {one.number for one in known}
    images = render_crowds(world, condition, count, _WIDTH_PX, seed, **placed, left_out=done)
    for number, image in zip((number for number in range(count) if number not in done), images):
        outcome = search_image(image, detectors, series, seed, number)
        append_outcome(file, outcome)
        known.append(outcome)
    return sorted((one for one in known if one.number < count), key=lambda one: one.number)


def recall_rows(name: str, street: Sequence[Outcome], near: Sequence[Outcome], how: Redaction) -> Iterator[Row]:
    """Yield recall and over-coverage of one light, from images of the street and of near cars."""
    tally = Tally()
    for outcome in street:
        tally.add(outcome, how)
    for outcome in near:
        tally.add(outcome, how, plates_only=True)
    yield from tally.rows(name)


def attack_rows(plates: int) -> Iterator[Row]:
    """Yield the share of characters that the template attack reads from the toolkit's operators."""
    how, size = Redaction(), f"{plates} plates of {_ATTACK_PX} px, 4 images each"
    filled = 100.0 * read_plates(redacting("plate", how), _ATTACK_PX, plates)
    bar = 100.0 * (CHANCE + _ATTACK_MARGIN)
    yield Row(f"mean fill: characters read (%); chance {100.0 * CHANCE:.1f}", size, filled, bar=bar)


def control_rows(plates: int) -> Iterator[Row]:
    """Yield the characters that the attack reads from operators that do not protect plates."""
    size = f"{plates} plates of {_ATTACK_PX} px, 4 images each"
    control = 100.0 * read_plates(mosaic(16, 5), _ATTACK_PX, plates)
    yield Row("mosaic of 16 x 5 cells: characters not read (%)", size, 100.0 - control, bar=100.0 * _CONTROL)
    few = max(plates // 10, 1)
    cells = 100.0 * read_plates(redacting("face", Redaction()), _ATTACK_PX, few)
    yield Row("4 x 4 smoothed cells, the operator of faces: characters read (%)", f"{few} plates", cells)


def time_rows(faces: Path) -> Iterator[Row]:
    """Yield the processor time of the detectors for an image, on one thread."""
    world = build_street()
    image = next(iter(render_crowds(world, make_condition("day", "clear"), 1, _WIDTH_PX, _SEED)))
    rgb, size = np.ascontiguousarray(image.bgr[..., ::-1]), f"{_WIDTH_PX} x {_WIDTH_PX * 9 // 16}, one thread"
    options = DetectorOptions(faces)
    single, tiled = YuNet(options, tiled=False), YuNet(options)
    chinese, plates = ChinesePlates(DetectorOptions()), WorldPlates(DetectorOptions())
    yield Row("YuNet, image only (ms)", size, _processor_ms(lambda: single(rgb), 15), bar=_YUNET_MS)
    yield Row("YuNet, image and tiles at 2 x (ms)", size, _processor_ms(lambda: tiled(rgb), 5))
    yield Row("world_plates, image and 0.4 of it (ms)", size, _processor_ms(lambda: plates(rgb), 15))
    yield Row("clp_det, image, half of it, and tiles at 2 x and 3 x (ms)", size, _processor_ms(lambda: chinese(rgb), 3))
    large = np.asarray(cv2.resize(rgb, (1280, 720), interpolation=cv2.INTER_CUBIC), np.uint8)
    of_large = _processor_ms(lambda: plates(large), 15)
    yield Row("world_plates, image and 0.4 of it (ms)", "1280 x 720, one thread", of_large, bar=_WORLD_PLATES_MS)


def _processor_ms(call: Callable[[], object], repeats: int) -> float:
    """The median processor time of a call on one thread, after one that does not count."""
    call()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(1e3 * (time.process_time() - start))
    return float(np.median(times))


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks privacy")
    parser.add_argument("--sections", nargs="+", choices=SECTIONS, default=list(SECTIONS))
    names = [f"{light}-{weather}" for light, weather in CONDITIONS]
    parser.add_argument("--lights", nargs="+", choices=names, default=[], help="only these; default: all")
    parser.add_argument("--images", type=int, default=40, help="number of images of each light")
    parser.add_argument("--near", type=int, default=200, help="number of images of near cars of each light")
    parser.add_argument("--plates", type=int, default=200, help="number of plates that are attacked")
    parser.add_argument("--faces", type=Path, default=face_weights(), help="yunet_n_dynamic.onnx")
    options = parser.parse_args(argv)
    cv2.setNumThreads(1)
    code: int = ExitCode.DONE
    if "time" in options.sections:
        code = max(code, report("privacy_time", {"time": time_rows(options.faces)}))
    if {"recall", "boxes"} & set(options.sections):
        code = max(code, _report_images(options))
    if "attack" in options.sections:
        code = max(code, report("privacy_attack", {"attack": attack_rows(options.plates)}))
    if "control" in options.sections:
        code = max(code, report("privacy_control", {"control": control_rows(options.plates)}))
    return code


def _report_images(options: argparse.Namespace) -> int:
    """Search what is missing, and report the sections that count regions of images."""
    plates = WorldPlates(DetectorOptions())
    detectors: dict[str, list[Detector]] = {
        "street": [YuNet(DetectorOptions(options.faces)), plates],
        # Cars that stand so close are there for their plates.
        "near": [plates],
    }
    chosen = [one for one in CONDITIONS if not options.lights or "-".join(one) in options.lights]
    found = search_lights(chosen, {"street": options.images, "near": options.near}, detectors)
    code: int = ExitCode.DONE
    for (light, weather), outcomes in found.items() if "recall" in options.sections else ():
        rows = recall_rows(f"{light} {weather}", outcomes["street"], outcomes["near"], Redaction())
        name = f"privacy_recall_{light}_{weather}"
        code = max(code, report(name, {f"{light} {weather}": rows}, errors="95 % bound (%)"))
    if "boxes" in options.sections:
        street, near = ([one for light in found.values() for one in light[series]] for series in ("street", "near"))
        rows = box_error_rows(street, near, Redaction())
        code = max(code, report("privacy_boxes", {"boxes": rows}, errors="95 % bound (%)"))
    return code
