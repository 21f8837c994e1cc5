"""Long drives without images, and the peak memory of an ingest of them in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tests.builders.folder import LAT, LON, START_NS, folder_document

RADIUS_M = 400.0
"""Of the circle that is driven round and round, at 8 m/s."""
_DEGREE_M = 111_320.0
_MEASURED = """
import resource, sys
from mirror.cli.main import main
code = main(sys.argv[1:])
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
sys.exit(code)
"""


def write_drives(root: Path, count: int, poses: int) -> list[Path]:
    """Drives of so many poses at 10 Hz, one after the other."""
    seconds = np.arange(poses) / 10.0
    angle = 8.0 * seconds / RADIUS_M
    lon = LON + RADIUS_M * np.cos(angle) / (_DEGREE_M * np.cos(np.radians(LAT)))
    lat = LAT + RADIUS_M * np.sin(angle) / _DEGREE_M
    drives = []
    for number in range(count):
        drive = root / f"drive_{number:03d}"
        drive.mkdir(parents=True)
        stamps = START_NS + number * 86_400_000_000_000 + np.round(seconds * 1e9).astype(np.int64)
        columns = {"timestamp_ns": stamps, "longitude_deg": lon, "latitude_deg": lat, "height_m": np.full(poses, 520.0)}
        pq.write_table(pa.table(columns), drive / "poses.parquet")
        document = folder_document(drive.name, weather="clear")
        (drive / "recording.json").write_text(json.dumps(document))
        drives.append(drive)
    return drives


def peak_bytes(drives: Sequence[Path], out: Path, radius_m: float) -> int:
    """Largest resident memory of `mirror ingest`, its index included.

    Args:
        drives: the recordings.
        out: the dataset.
        radius_m: of the ROI, whose centre lies on the circle that is driven.
    """
    lon = LON + RADIUS_M / (_DEGREE_M * np.cos(np.radians(LAT)))
    roi = ["--roi", f"{lon},{LAT},{radius_m},circle", "--workers", "2"]
    words = [sys.executable, "-c", _MEASURED, "ingest", *map(str, drives), *roi, "--out", str(out)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return int(done.stdout.strip().splitlines()[-1])
