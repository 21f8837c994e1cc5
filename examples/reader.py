"""A reader in one file: drives as JSON lines of time, longitude and latitude.

mirror ingest drive.walk --reader examples/reader.py:WalkReader --roi LON,LAT --out dataset
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mirror.recordings import CALIBRATIONS, DriveInfo, FileStream, Track


@dataclass(frozen=True)
class Walk:
    """A drive without cameras; see `mirror.recordings.Recording`."""

    path: Path
    rig: None = None

    @property
    def info(self) -> DriveInfo:
        """The drive and its vehicle."""
        return DriveInfo(self.path.stem, vehicle_id="walker", vehicle_type="unknown", time_base="Unix seconds")

    def files(self) -> Sequence[tuple[str, Path | str]]:
        """Return the files of the recording, for its fingerprint."""
        return [(self.path.name, self.path)]

    def track(self) -> Track:
        """Return all poses."""
        rows = [json.loads(line) for line in self.path.read_text().splitlines()]
        seconds, longitude, latitude = np.array([[row[key] for key in ("t", "lon", "lat")] for row in rows]).T
        return Track((seconds * 1e9).astype(np.int64), longitude, latitude, file=self.path)

    def calibrations(self) -> Any:
        """Return no calibrations."""
        return CALIBRATIONS.schema.empty_table()

    def images(self) -> Mapping[str, FileStream]:
        """Return no images."""
        return {}

    def boxes(self) -> None:
        """Return None: there are no boxes."""


class WalkReader:
    """See `mirror.recordings.Reader`."""

    name = "walk"
    expects = "a .walk file: one JSON object a line, with t, lon and lat"

    def recognises(self, path: Path) -> bool:
        """Return whether the path has this format, by its name."""
        return path.suffix == ".walk"

    def open(self, path: Path, options: Mapping[str, str]) -> Walk:
        """Open a recording."""
        return Walk(path)
