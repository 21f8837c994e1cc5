"""Measures a fleet's index: many rows after compaction, and a tail of runs that each added a segment.

``python -m benchmarks fleet_index [--rows N] [--tail N] [--keep FOLDER]`` writes recorded tables without images, a
compact index of ``--rows`` image rows (7 cameras, 400 frames a traversal, 200,000 rows a scene), and then ``--tail``
drives, each by a run of its own. Beside it, in the same run and by turns, a compact index of 2 million rows is
measured. Printed are medians of processor time: of `mirror.open`; and of a scene's images of one camera, as the first
query of a dataset that was just opened, then of another scene, then the same once more.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

import mirror
from mirror.dataset import Dataset
from mirror.dataset.index import append_drives, build_index
from mirror.errors import ExitCode
from tests.builders.dataset import EPOCH, SECOND, SEVEN, Builder, Pass

FRAMES: Final = 400
ROWS_A_SCENE: Final = 200_000
BASE_ROWS: Final = 2_000_000
CAMERA: Final = "front_wide"
COLUMNS: Final = ("scene_id", "traversal_id", "camera", "timestamp_ns", "uri")
OPEN_BAR_MS: Final = 50.0
QUERY_BAR_MS: Final = 5 * 9.5
ROUNDS: Final = 15
_BARS: Final = {"open": OPEN_BAR_MS, "first query": None, "another scene": None, "the same once more": QUERY_BAR_MS}

Result = TypeVar("Result")


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="benchmarks fleet_index", description=__doc__)
    parser.add_argument("--rows", type=int, default=10_000_000, help="image rows of the compact segment")
    parser.add_argument("--tail", type=int, default=100, help="segments after it, of a drive each")
    parser.add_argument("--keep", type=Path, help="make the datasets here, and use those that are there")
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        roots = {
            "base": _make(folder, min(BASE_ROWS, options.rows), 0),
            "large": _make(folder, options.rows, options.tail),
        }
        figures = _measure(roots)
        for name, root in roots.items():
            dataset = mirror.open(root)
            segments = len(dataset.catalog.snapshot.segments)
            print(f"{name}: {dataset.count('images'):,} rows, {len(dataset.scenes())} scenes, {segments} segments")
    is_missed = False
    print(f"{'CPU-ms':20}{'base':>10}{'large':>10}")
    for what, bar in _BARS.items():
        base, large = (figures[name][what] for name in roots)
        verdict = "" if bar is None else f"   bar {bar:g}: {'met' if large <= bar else 'missed'}"
        is_missed |= bar is not None and large > bar
        print(f"{what:20}{base:10.1f}{large:10.1f}{verdict}")
    return ExitCode.FINDINGS if is_missed else ExitCode.DONE


def _make(folder: Path, rows: int, tail: int) -> Path:
    root = folder / f"rows-{rows}-{tail}"
    if (root / "made").exists():
        return root
    traversals, scenes = round(rows / (FRAMES * len(SEVEN))), max(round(rows / ROWS_A_SCENE), 1)
    builder = Builder(root, cameras=SEVEN, size=(960, 540))
    for scene in range(scenes):
        builder.scene(f"s{scene}", -79.4 + 0.02 * (scene % 100), 43.6 + 0.02 * (scene // 100))
    for number in range(traversals):
        _drive(builder, number, scenes)
    build_index(root)
    for number in range(traversals, traversals + tail):
        append_drives(builder.layout, [_drive(builder, number, scenes)])
    (root / "made").touch()
    return root


def _drive(builder: Builder, number: int, scenes: int) -> str:
    light = ("day", "dusk", "night")[number % 3]
    one = Pass(f"s{number % scenes}", EPOCH + number * 1000 * SECOND, frames=FRAMES, light=light)
    builder.drive(f"d{number}", [one])
    return f"d{number}"


def _measure(roots: Mapping[str, Path]) -> dict[str, dict[str, float]]:
    """Return the medians of processor time, ms, by dataset and by what was done."""
    times: dict[str, dict[str, list[float]]] = {name: {what: [] for what in _BARS} for name in roots}
    scenes = {name: len(mirror.open(root).scenes()) for name, root in roots.items()}
    for number in range(ROUNDS):
        for name, root in roots.items():
            dataset, opened = _timed(partial(mirror.open, root))
            found = [opened]
            for scene in (number, number + 1, number + 1):
                _, ms = _timed(partial(_query, dataset, f"s{scene % scenes[name]}"))
                found.append(ms)
            for what, ms in zip(_BARS, found):
                times[name][what].append(ms)
    return {name: {what: statistics.median(ms) for what, ms in own.items()} for name, own in times.items()}


def _query(dataset: Dataset, scene: str) -> object:
    return dataset.where(scene=scene, camera=CAMERA).table("images", COLUMNS)


def _timed(run: Callable[[], Result]) -> tuple[Result, float]:
    start = time.process_time()
    result = run()
    return result, (time.process_time() - start) * 1e3
