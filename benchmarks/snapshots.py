"""Measures what snapshots of the index cost: appending a drive, opening, and an ingest without news.

``python -m benchmarks snapshots [--traversals N] [--rounds N]`` prints, for a scene of 10 and of N traversals:
processor time of appending the drives of five runs to the index, requests and processor time of `mirror.open`, and
processor time a drive of telling that the dataset has it unchanged. The drives are small: what grows with the dataset
shows. Then another process opens a dataset again and again during 100 rounds of append and compaction, and requires
whole snapshots.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import mirror
from mirror.dataset.index import append_drives, build_index
from mirror.dataset.store import Store
from mirror.errors import DatasetError, ExitCode
from mirror.ingest.known_drives import KnownDrives
from tests.builders.dataset import Builder
from tests.builders.snapshot_reader import read_while_changing, write_drive

SMALL = 10
FINGERPRINT = "0" * 64
"""Of the recordings and options of `Builder`."""

RUNS = 5
OPENINGS = 20


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(prog="benchmarks snapshots", description=__doc__)
    parser.add_argument("--traversals", type=int, default=1000, help="in the scene of the larger dataset")
    parser.add_argument("--rounds", type=int, default=100, help="of append and compaction beside a reader")
    options = parser.parse_args(argv)
    traversals, rounds = options.traversals, options.rounds
    with tempfile.TemporaryDirectory() as folder:
        small = _measure(Path(folder) / "small", SMALL)
        large = _measure(Path(folder) / "large", traversals)
        openings, seen = read_while_changing(Path(folder) / "changing", rounds)
    print(f"{'':32} {SMALL:>12} {traversals:>12}")
    for name in small:
        print(f"{name:32} {small[name]:12.3f} {large[name]:12.3f}")
    print(f"{rounds} rounds of append and compaction: {openings} openings of {seen} snapshots, all of them whole")
    return ExitCode.DONE


def _measure(root: Path, traversals: int) -> dict[str, float]:
    builder = Builder(root, cameras=("front_wide",))
    builder.scene("a")
    drives = [write_drive(builder, number) for number in range(traversals)]
    build_index(root)
    added = [write_drive(builder, traversals + number) for number in range(RUNS)]
    start = time.process_time()
    for drive_id in added:
        append_drives(builder.layout, [drive_id])
    append_s = (time.process_time() - start) / RUNS
    mirror.open(root)
    start = time.process_time()
    for _ in range(OPENINGS):
        mirror.open(root)
    open_s = (time.process_time() - start) / OPENINGS
    build_index(root, compact=True)
    listed, opened = _calls(lambda: KnownDrives.read(Store(root)))
    start = time.process_time()
    # As `mirror ingest` does for drives whose recordings have not changed.
    known = KnownDrives.read(Store(root))
    for drive_id in drives:
        if not known.has_unchanged(drive_id, FINGERPRINT, FINGERPRINT, {"a"}):
            raise DatasetError("the drive is not as it was written", file=builder.layout.drive(drive_id))
    unchanged_s = (time.process_time() - start) / len(drives)
    return {
        "append a drive, CPU-ms": 1e3 * append_s,
        "open, requests": _requests(root),
        "open, CPU-ms": 1e3 * open_s,
        "unchanged drive, CPU-ms": 1e3 * unchanged_s,
        "ingest without news, listings": listed,
        "ingest without news, files read": opened,
    }


def _requests(root: Path) -> int:
    """Count the reads and listings of an opening."""
    # A URL, so that nothing is read past the store.
    return sum(_calls(lambda: mirror.open(f"file://{root}")))


def _calls(run: Callable[[], object]) -> tuple[int, int]:
    """Count the folders that are listed, and the files that are read."""
    listed = read = 0
    plain = {name: getattr(Store, name) for name in ("read", "read_many", "list_files", "list_folders")}

    def counting(name: str) -> Any:
        def counted(self: Store, given: Any) -> Any:
            nonlocal listed, read
            listed += name.startswith("list")
            read += len(given) if name == "read_many" else name == "read"
            return plain[name](self, given)

        return counted

    try:
        for name in plain:
            setattr(Store, name, counting(name))
        run()
    finally:
        for name, function in plain.items():
            setattr(Store, name, function)
    return listed, read
