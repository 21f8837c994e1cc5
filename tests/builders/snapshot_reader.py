"""A process that opens a dataset again and again while this one changes it, and requires that each snapshot is whole.

The dataset is one of `Builder` with one camera, whose drives ``d00000``, ``d00001`` ... are added in order, one
traversal of ``FRAMES`` frames each.
"""

from __future__ import annotations

import json
import select
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

import mirror
from mirror.dataset import Dataset
from mirror.dataset.index import append_drives, build_index
from mirror.errors import DatasetError
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass

FRAMES: Final = 3
_END_S: Final = 120.0
_MODULE: Final = "tests.builders.snapshot_reader"


def write_drive(builder: Builder, number: int) -> str:
    """Write a drive without indexing it; its id comes back."""
    builder.drive(f"d{number:05}", [Pass("a", EPOCH + number * 10 * SECOND, frames=FRAMES)])
    return f"d{number:05}"


def read_while_changing(root: Path, rounds: int) -> tuple[int, int]:
    """Add a drive and make the index compact in every round, while another process reads.

    Returns:
        The number of openings of the other process, and of the snapshots that it saw.

    Raises:
        DatasetError: it saw a snapshot that was not whole, or could not read one.
    """
    builder = Builder(root, cameras=("front_wide",))
    builder.scene("a")
    write_drive(builder, 0)
    build_index(root)

    def change() -> None:
        for number in range(1, rounds + 1):
            append_drives(builder.layout, [write_drive(builder, number)])
            build_index(root, compact=True)

    return _with_reader(root, change)


def _with_reader(root: Path, change: Callable[[], None]) -> tuple[int, int]:
    command = [sys.executable, "-m", _MODULE, str(root.absolute())]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2]
    ) as reader:
        if reader.stdin is None or reader.stdout is None:
            raise DatasetError("the reader has no pipes", file=root)
        reader.stdout.readline()
        try:
            change()
        finally:
            answer, _ = reader.communicate("end\n", timeout=_END_S)
    if reader.returncode != 0:
        raise DatasetError(f"the reader ended with {reader.returncode}: {answer}", file=root)
    seen = json.loads(answer)
    return int(seen["openings"]), len(seen["snapshots"])


def require_whole(dataset: Dataset) -> int:
    """Require that a snapshot has all rows of each of its drives, and return the number of the drives."""
    drives = dataset.drives()
    expected = [f"d{number:05}" for number in range(len(drives))]
    ids = sorted(dataset.traversals())
    for name, rows in (("images", FRAMES), ("frames", FRAMES), ("calibrations", 1)):
        found = sorted(dataset.table(name, ["traversal_id"]).column(0).to_pylist())
        if found != sorted(ids * rows):
            raise DatasetError(f"snapshot {dataset.snapshot}: {len(found)} rows of {name}", file=dataset.root)
    (scene,) = dataset.table("scenes", ["traversals"]).column(0).to_pylist()
    if drives != expected or not len(drives) == len(ids) == dataset.passes().num_rows == scene:
        raise DatasetError(f"snapshot {dataset.snapshot}: drives {drives}, {len(ids)} traversals", file=dataset.root)
    return len(drives)


def _read(root: str) -> None:
    openings, most, snapshots = 0, 0, set()
    before: Dataset | None = None
    while not select.select([sys.stdin], [], [], 0.0)[0]:
        dataset = mirror.open(root)
        count = require_whole(dataset)
        if count < most:
            raise DatasetError(f"snapshot {dataset.snapshot} has {count} drives, one before had {most}", file=root)
        most = count
        if before is not None:
            # A view that was opened earlier goes on reading its own snapshot.
            require_whole(before)
        before, openings = dataset, openings + 1
        snapshots.add(dataset.snapshot)
        if openings == 1:
            print("reading", flush=True)
    print(json.dumps({"openings": openings, "snapshots": sorted(snapshots)}))


if __name__ == "__main__":
    _read(sys.argv[1])
