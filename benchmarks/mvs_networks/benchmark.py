"""Measures error and time of depth by PatchmatchNet and by plane sweeps, on synthetic and real images.

``python -m benchmarks mvs_networks --weights FILE``. Times are processor times of all cores for one image. Real images
are read from ``MIRROR_REAL_DATA``.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.mvs_networks.cases import Case, dgp_cases, street_cases
from benchmarks.report import Peer, Row, report
from hybridworldsim.mvs.estimator import DepthEstimator, DepthMap
from hybridworldsim.mvs.patchmatchnet.estimator import PatchmatchNetEstimator
from mirror.arrays import Bool
from mirror.weights.resolve import WeightResolver

_EDGES_M: Final = (2.0, 5.0, 10.0, 20.0, 40.0, 80.0)
_SIZES: Final = ((320, 240), (640, 480))
_RANGE_M: Final = {"synthetic street": (2.0, 120.0), "six real cameras": (3.0, 150.0)}
_CONFIDENT: Final = 0.8
_BAD: Final = 0.1


def main(argv: list[str]) -> int:
    from hybridworldsim.mvs.plane_sweep import PlaneSweep

    parser = argparse.ArgumentParser(prog="benchmarks mvs_networks")
    parser.add_argument("--weights", type=Path, help="the published checkpoint; default: where weights are looked for")
    parser.add_argument("--count", type=int, default=3, help="places a camera of the street")
    options = parser.parse_args(argv)
    given = {} if options.weights is None else {"patchmatchnet": options.weights}
    estimators: dict[str, DepthEstimator] = {
        "PatchmatchNet": PatchmatchNetEstimator.load(WeightResolver(given)),
        "plane sweep": PlaneSweep(),
    }
    groups: dict[str, Iterator[Row]] = {}
    for width, height in _SIZES:
        street = street_cases(width, height, options.count)
        groups[f"synthetic street, {width}x{height}"] = _rows(estimators, street, _RANGE_M["synthetic street"])
    folder = Path(os.environ.get("MIRROR_REAL_DATA", "../shared/data")) / "dgp_scene_02"
    if folder.is_dir():
        groups["six real cameras"] = _rows(estimators, dgp_cases(folder, 640), _RANGE_M["six real cameras"])
    return report("mvs_networks", groups, errors="median relative error, %")


def _rows(
    estimators: Mapping[str, DepthEstimator], cases: Iterator[Case], span_m: tuple[float, float]
) -> Iterator[Row]:
    """Rows of PatchmatchNet with the sweep as its peer, by distance: for all known and for confident pixels."""
    taken = list(cases)
    maps: dict[str, list[DepthMap]] = {}
    milliseconds: dict[str, float] = {}
    for name, estimator in estimators.items():
        first = taken[0]
        estimator(first.reference, first.sources[:1], *span_m)
        start = time.process_time()
        maps[name] = [estimator(case.reference, case.sources, *span_m) for case in taken]
        milliseconds[name] = 1e3 * (time.process_time() - start) / len(taken)
    ours, *others = estimators
    for low, high in pairwise(_EDGES_M):
        for sure in (False, True):
            figures = {name: _figures(found, taken, (low, high), sure) for name, found in maps.items()}
            error, text = figures[ours]
            yield Row(
                f"{low:g}-{high:g} m{', confident' if sure else ''}",
                f"{len(taken)} images, {text}",
                milliseconds[ours],
                error,
                tuple(Peer(f"{name} ({figures[name][1]})", milliseconds[name], figures[name][0]) for name in others),
                unit="%",
            )


def _figures(
    found: Sequence[DepthMap], cases: Sequence[Case], ring_m: tuple[float, float], sure: bool
) -> tuple[float, str]:
    """Median relative error in percent, the share of the distance range that is known, and the share off by a tenth."""
    errors, pixels = [], 0
    for depth, case in zip(found, cases):
        ring: Bool = (case.depth_m >= ring_m[0]) & (case.depth_m < ring_m[1])
        known = ring & np.isfinite(depth.depth_m)
        if sure:
            known &= depth.confidence >= _CONFIDENT
        pixels += int(ring.sum())
        errors.append(np.abs(depth.depth_m[known] - case.depth_m[known]) / case.depth_m[known])
    error = np.concatenate(errors)
    if not len(error):
        return float("nan"), "none known"
    known_share, bad = 100.0 * len(error) / pixels, 100.0 * float(np.mean(error > _BAD))
    return 100.0 * float(np.median(error)), f"{known_share:.0f} % known, {bad:.0f} % of it off by 10 %"
