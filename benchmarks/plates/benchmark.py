"""Number plates of many countries: which plates the detectors cover, by width, and what they cover beside them.

``python -m benchmarks plates [--detectors world_plates clp_det] [--images N]`` on synthetic plates of 20 to 500 px in
images of 1280 x 720 pixels, with exact corners, turned by up to 30 degrees, with dirt, frames and bands; their designs,
typefaces and dirt are those of no training. A plate counts as covered if the redaction covers 90 % of its area.
Only the detectors count: nothing is propagated. The backgrounds, 16 synthetic streets, are kept in
``benchmarks/out/plates_streets.npz``. `mirror weights fetch clp_det` gets the weights that are no part of the toolkit.

``--regions AR AU ... --recall FILE`` measures the recall of plates with the shapes of each region, which the detector
``world_plates`` publishes: it counts as a detector of a region's plates only if that recall is enough.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from benchmarks.plates.backgrounds import Background, load_backgrounds, render_streets, save_backgrounds
from benchmarks.plates.fonts import held_out_glyphs
from benchmarks.plates.held_out import EDGES_PX, SEED, draw_held_out
from benchmarks.plates.recall import PlateTally
from benchmarks.plates.regions import REGIONS
from benchmarks.report import OUT, Row, report
from mirror.errors import ExitCode
from mirror.privacy.detectors.protocol import Detector
from mirror.privacy.detectors.recall import RegionRecall, SyntheticRecall
from mirror.privacy.detectors.registry import DetectorChoice
from mirror.schema.files import write_json

_STREETS: Final = 16
_STREETS_SEED: Final = 9000
_FROM_64_PX: Final = EDGES_PX[2:]


def streets() -> list[Background]:
    """Return the backgrounds of the test; they are rendered once."""
    file = OUT / "plates_streets.npz"
    if not file.is_file():
        OUT.mkdir(exist_ok=True)
        save_backgrounds(file, list(render_streets(_STREETS, _STREETS_SEED)))
    return load_backgrounds(file)


def plate_rows(detectors: Sequence[Detector], count: int) -> Iterator[Row]:
    """Yield the missed plates and the needlessly covered area of each detector, its time, and those of all together."""
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


def region_recall(name: str, images: int, regions: Sequence[str]) -> SyntheticRecall:
    """Measure the share of plates from 64 px that a detector covers, by the shapes of each region.

    Args:
        name: the detector.
        images: number of images of each region.
        regions: keys of `REGIONS`.
    """
    detector, found = DetectorChoice(name).make(), {}
    for region in regions:
        tally = PlateTally()
        seed = SEED + 1 + sorted(REGIONS).index(region)
        drawn = draw_held_out(
            images, streets(), held_out_glyphs(), designs=REGIONS[region], edges_px=_FROM_64_PX, seed=seed
        )
        for image in drawn:
            tally.add(image, detector(image.image))
        (missed, plates), (near_missed, near) = tally.missed(0.0), tally.missed(192.0)
        found[region] = RegionRecall(
            plates=plates, covered=plates - missed, near_plates=near, near_covered=near - near_missed
        )
        print(f"{region}: {found[region]}", file=sys.stderr, flush=True)
    return SyntheticRecall(weights_sha256=detector.weights_sha256, images=images, regions=found)


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks plates")
    parser.add_argument(
        "--detectors", nargs="+", default=["world_plates"], help="names of installed detectors of plates"
    )
    parser.add_argument("--images", type=int, default=120, help="number of images; 0: none")
    parser.add_argument("--regions", nargs="+", choices=sorted(REGIONS), default=[], help="measure recall by region")
    parser.add_argument("--region-images", type=int, default=30, help="number of images of each region")
    parser.add_argument("--recall", type=Path, help="file for the recall by region of the first detector")
    options = parser.parse_args(argv)
    cv2.setNumThreads(1)
    if options.regions:
        recall = region_recall(options.detectors[0], options.region_images, options.regions)
        if options.recall is not None:
            write_json(options.recall, recall)
    if not options.images:
        return ExitCode.DONE
    detectors = [DetectorChoice(name).make() for name in options.detectors]
    return report("plates", {"plates": plate_rows(detectors, options.images)}, errors="95 % bound (%)")
