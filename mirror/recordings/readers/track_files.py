"""Recordings of one file with a track and no cameras, as receivers and phones write it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64, Int64
from mirror.errors import RecordingError
from mirror.recordings.calibration import to_calibration_table
from mirror.recordings.paths import to_identifier
from mirror.recordings.protocol import DriveInfo, ImageStream, Track
from mirror.recordings.registry import refuse_options
from mirror.recordings.row_faults import RowFaults

_OPTIONS: Final = ("drive_id", "vehicle_id", "vehicle_type")


@dataclass(frozen=True, eq=False)
class FileFixes:
    """The fixes of a file.

    Attributes:
        timestamp_ns: (N,) Unix time.
        longitude_deg: (N,) WGS 84; NaN: no fix.
        latitude_deg: (N,) WGS 84; NaN: no fix.
        height_m: (N,) above the ellipsoid as far as the file tells; NaN where it has none.
        faults: rows of the file that make no pose.
        notes: choices where the file leaves one open.
    """

    timestamp_ns: Int64
    longitude_deg: Float64
    latitude_deg: Float64
    height_m: Float64
    faults: RowFaults
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class TrackRecording:
    """A drive with fixes and no cameras, with its orientation from the direction of travel."""

    path: Path
    time_base: str
    options: Mapping[str, str]
    fixes: FileFixes

    @property
    def info(self) -> DriveInfo:
        """The drive; its ids come from the options or the file's name."""
        return DriveInfo(
            drive_id=to_identifier(self.options.get("drive_id", self.path.resolve().stem)),
            vehicle_id=to_identifier(self.options.get("vehicle_id", "unknown")),
            vehicle_type=self.options.get("vehicle_type", "unknown"),
            time_base=self.time_base,
            notes=self.fixes.notes,
        )

    @property
    def rig(self) -> None:
        """None: the file has no cameras."""
        return

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the file."""
        return [(self.path.name, self.path)]

    def track(self) -> Track:
        """Return all fixes."""
        fixes = self.fixes
        height = fixes.height_m if np.isfinite(fixes.height_m).any() else None
        track = Track(
            fixes.timestamp_ns, fixes.longitude_deg, fixes.latitude_deg, height_m=height, file=self.path
        )  # fmt: skip
        return fixes.faults.drop_from(track)

    def calibrations(self) -> pa.Table:
        """Return a table without rows."""
        return to_calibration_table([], vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def images(self) -> Mapping[str, ImageStream]:
        """Return no streams."""
        return {}

    def boxes(self) -> None:
        """Return None: the file has no boxes."""
        return


def require_track_file(path: Path, options: Mapping[str, str], reader: str, expected: str) -> None:
    """Refuse a folder, and options that track files do not have.

    Raises:
        RecordingError: the path or the option is named.
    """
    refuse_options(options, _OPTIONS, path, reader)
    if not path.is_file():
        raise RecordingError("a folder", file=path, expected=expected, remedy="name the file: each is a drive")
