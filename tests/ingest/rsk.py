"""The real drives with a receiver that repeats its fix."""

from __future__ import annotations

import csv
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from mirror.recordings.protocol import Track


def rsk_track(path: Path) -> Track:
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    stamps = [
        int(datetime.strptime(f"{row['Date']} {row['Time']}", "%m/%d/%Y %H:%M:%S").replace(tzinfo=UTC).timestamp())
        for row in rows
    ]
    return Track(
        timestamp_ns=np.array(stamps, np.int64) * 10**9,
        longitude_deg=np.array([float(row["LON"]) for row in rows]),
        latitude_deg=np.array([float(row["LAT"]) for row in rows]),
        file=path,
    )
