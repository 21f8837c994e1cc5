"""Measures what snapshots of the index cost: appending a drive, opening, and an ingest without news.

``python -m benchmarks snapshots [--traversals N]`` prints, for a scene of 10 and of N traversals: processor time of
appending the drives of five runs to the index, requests and processor time of `mirror.open`, and processor time a drive
of telling that the dataset has it unchanged. The drives are small: what grows with the dataset shows.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mirror
from mirror.dataset.index import append_drives, build_index
from mirror.dataset.layout import complete_manifest, is_intact
from mirror.dataset.store import Store
from mirror.errors import DatasetError, ExitCode
from mirror.ingest.drive import are_traversals_intact
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass

SMALL = 10
RUNS = 5
OPENINGS = 20


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="benchmarks snapshots", description=__doc__)
    parser.add_argument("--traversals", type=int, default=1000, help="in the scene of the larger dataset")
    traversals = parser.parse_args(argv).traversals
    with tempfile.TemporaryDirectory() as folder:
        small = _measure(Path(folder) / "small", SMALL)
        large = _measure(Path(folder) / "large", traversals)
    print(f"{'':32} {SMALL:>12} {traversals:>12}")
    for name in small:
        print(f"{name:32} {small[name]:12.3f} {large[name]:12.3f}")
    return ExitCode.DONE


def _measure(root: Path, traversals: int) -> dict[str, float]:
    builder = Builder(root, cameras=("front_wide",))
    builder.scene("a")
    drives = [_drive(builder, number) for number in range(traversals)]
    build_index(root)
    added = [_drive(builder, traversals + number) for number in range(RUNS)]
    start = time.process_time()
    for drive_id in added:
        append_drives(builder.layout, [drive_id])
    append_s = (time.process_time() - start) / RUNS
    mirror.open(root)
    start = time.process_time()
    for _ in range(OPENINGS):
        mirror.open(root)
    open_s = (time.process_time() - start) / OPENINGS
    start = time.process_time()
    for drive_id in drives:
        # As `mirror ingest` does for a drive whose recording has not changed.
        folder = builder.layout.drive(drive_id)
        is_unchanged = is_intact(folder) and complete_manifest(folder) is not None
        if not (is_unchanged and are_traversals_intact(builder.layout, drive_id)):
            raise DatasetError("the drive is not as it was written", file=folder)
    unchanged_s = (time.process_time() - start) / len(drives)
    return {
        "append a drive, CPU-ms": 1e3 * append_s,
        "open, requests": _requests(root),
        "open, CPU-ms": 1e3 * open_s,
        "unchanged drive, CPU-ms": 1e3 * unchanged_s,
    }


def _drive(builder: Builder, number: int) -> str:
    builder.drive(f"d{number:05}", [Pass("a", EPOCH + number * 10 * SECOND, frames=3)])
    return f"d{number:05}"


def _requests(root: Path) -> int:
    """The number of reads and listings of an opening."""
    count = 0
    plain = {name: getattr(Store, name) for name in ("read", "read_many", "list_files", "list_folders")}

    def counting(name: str) -> Any:
        def counted(self: Store, given: Any) -> Any:
            nonlocal count
            count += len(given) if name == "read_many" else 1
            return plain[name](self, given)

        return counted

    try:
        for name in plain:
            setattr(Store, name, counting(name))
        # A URL, so that nothing is read past the store.
        mirror.open(f"file://{root}")
    finally:
        for name, function in plain.items():
            setattr(Store, name, function)
    return count
