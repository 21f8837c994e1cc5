"""Number plates of many countries: which plates the detectors cover, by width, and what they cover beside them.

``python -m benchmarks plates [--detectors plates clp_det] [--images N]`` on synthetic plates of 20 to 500 px in images
of 1280 x 720 pixels, with exact corners, turned by up to 30 degrees, with dirt, frames and bands; their designs,
typefaces and dirt are those of no training. A plate counts as covered if the redaction covers 90 % of its area.
Only the detectors count: nothing is propagated. The backgrounds, 16 synthetic streets, are kept in
``benchmarks/out/plates_streets.npz``. `mirror weights fetch clp_det` gets the weights that are no part of the toolkit.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Final

import cv2
import numpy as np

from benchmarks.plates.backgrounds import load_backgrounds, render_streets, save_backgrounds
from benchmarks.plates.fonts import held_out_glyphs
from benchmarks.plates.held_out import draw_held_out
from benchmarks.plates.recall import PlateTally
from benchmarks.report import OUT, Row, report
from mirror.arrays import UInt8
from mirror.privacy.detectors.protocol import Detector
from mirror.privacy.detectors.registry import DetectorChoice

_STREETS: Final = 16
_STREETS_SEED: Final = 9000


def streets() -> list[UInt8]:
    """The backgrounds of the test; they are rendered once."""
    file = OUT / "plates_streets.npz"
    if not file.is_file():
        OUT.mkdir(exist_ok=True)
        save_backgrounds(file, list(render_streets(_STREETS, _STREETS_SEED)))
    return load_backgrounds(file)


def plate_rows(detectors: Sequence[Detector], count: int) -> Iterator[Row]:
    """Yield what each detector misses, what it covers beside plates, and its time; then all of them together."""
    tallies = {one.name: PlateTally() for one in detectors}
    joined = PlateTally()
    times_ms: dict[str, list[float]] = {one.name: [] for one in detectors}
    for image in draw_held_out(count, streets(), held_out_glyphs()):
        found = []
        for one in detectors:
            start = time.process_time()
            regions = one(image.image)
            times_ms[one.name].append(1e3 * (time.process_time() - start))
            tallies[one.name].add(image, regions)
            found += regions
        joined.add(image, found)
        if (image.number + 1) % 10 == 0:
            print(f"{image.number + 1} of {count} images", file=sys.stderr, flush=True)
    for name, tally in tallies.items():
        yield from tally.rows(name)
        median = float(np.median(times_ms[name]))
        yield Row(f"{name}: processor time of an image, one thread (ms)", "1280 x 720", median)
    if len(detectors) > 1:
        yield from joined.rows(" + ".join(tallies))


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks plates")
    parser.add_argument("--detectors", nargs="+", default=["clp_det"], help="names of installed detectors of plates")
    parser.add_argument("--images", type=int, default=120)
    options = parser.parse_args(argv)
    cv2.setNumThreads(1)
    detectors = [DetectorChoice(name).make() for name in options.detectors]
    return report("plates", {"plates": plate_rows(detectors, options.images)}, errors="95 % bound (%)")
