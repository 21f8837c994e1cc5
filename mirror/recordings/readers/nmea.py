"""Reads logs of NMEA 0183 sentences: RMC (date, time, position) and GGA (height)."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Final

import numpy as np

from mirror.errors import RecordingError
from mirror.recordings.opening import read_file
from mirror.recordings.readers.track_files import FileFixes, TrackRecording, require_track_file
from mirror.recordings.row_faults import RowFaults
from mirror.recordings.time import SECOND_NS

_SUFFIXES: Final = (".nmea", ".nma")
# Years of two digits: GPS began in 1980.
_FIRST_YEAR: Final = 80


class NmeaReader:
    """A reader of a log of NMEA sentences as one drive."""

    name = "nmea"
    expects = "a file *.nmea with sentences RMC, and GGA for heights"

    def recognises(self, path: Path) -> bool:
        """Return whether a file has the suffix ``.nmea`` or ``.nma``."""
        return path.is_file() and path.suffix.lower() in _SUFFIXES

    def open(self, path: Path, options: Mapping[str, str]) -> TrackRecording:
        """Open a file; the options ``drive_id``, ``vehicle_id`` and ``vehicle_type`` name the drive."""
        require_track_file(path, options, self.name, self.expects)
        return TrackRecording(path, "UTC (NMEA)", dict(options), _read(path))


def _read(file: Path) -> FileFixes:
    rows: list[tuple[int, float, float, str]] = []
    heights: dict[str, float] = {}
    torn: list[tuple[int, RecordingError]] = []
    without_separation = False
    for number, line in enumerate(read_file(file).decode("ascii", errors="replace").splitlines(), 1):
        start = line.find("$")
        if start < 0:
            continue
        fields = _fields(line[start + 1 :])
        if fields is None:
            if line[start + 3 : start + 6] in ("RMC", "GGA"):
                torn.append((len(rows), _sentence_error(file, number, "the checksum differs, or the sentence is cut")))
            continue
        kind = fields[0][2:]
        if kind == "GGA" and len(fields) > 11 and fields[9]:
            separation = _number(fields[11])
            without_separation |= not np.isfinite(separation)
            heights[fields[1]] = _number(fields[9]) + (separation if np.isfinite(separation) else 0.0)
        elif kind == "RMC" and len(fields) > 9:
            stamp = _unix_ns(fields[9], fields[1])
            if stamp is None:
                torn.append((len(rows), _sentence_error(file, number, "no date and time")))
                continue
            valid = fields[2] == "A"
            longitude, latitude = _degrees(fields[5], fields[6]), _degrees(fields[3], fields[4])
            rows.append((stamp, longitude if valid else np.nan, latitude if valid else np.nan, fields[1]))
    if not rows:
        raise RecordingError(
            "no sentence RMC with a date", file=file, expected="$..RMC once a fix, and $..GGA for heights",
            remedy="let the receiver send RMC: GGA alone has no date",
        )  # fmt: skip
    stamps = np.array([row[0] for row in rows], np.int64)
    longitudes, latitudes = (np.array([row[axis] for row in rows], np.float64) for axis in (1, 2))
    # A time of day comes again after midnight; a log of one drive is shorter than a day.
    height = np.array([heights.get(row[3], np.nan) for row in rows], np.float64)
    notes = (
        ("heights of GGA without the separation of the geoid are taken as ellipsoidal: up to 100 m off",)
        if without_separation
        else ()
    )
    return FileFixes(stamps, longitudes, latitudes, height, RowFaults(len(rows), torn, reason="cells"), notes)


def _fields(text: str) -> list[str] | None:
    """The fields of a sentence after ``$``; None: its checksum differs, or it has none."""
    body, star, checksum = text.partition("*")
    try:
        if not star or reduce(xor, body.encode("ascii"), 0) != int(checksum.strip()[:2], 16):
            return None
    except ValueError:
        return None
    return body.split(",")


def _sentence_error(file: Path, line: int, problem: str) -> RecordingError:
    return RecordingError(
        problem,
        file=file,
        place=f"line {line}",
        expected="a whole sentence with its checksum",
        remedy="remove the line",
    )


def _unix_ns(date: str, time: str) -> int | None:
    """Unix nanoseconds of ``ddmmyy`` and ``hhmmss.sss``; None: there are none."""
    whole, _, fraction = time.partition(".")
    if not (len(date) == 6 and len(whole) == 6 and (date + whole + fraction).isdecimal()):
        return None
    year = int(date[4:])
    try:
        second = datetime(
            (1900 if year >= _FIRST_YEAR else 2000) + year, int(date[2:4]), int(date[:2]),
            int(whole[:2]), int(whole[2:4]), int(whole[4:]), tzinfo=UTC,
        )  # fmt: skip
    except ValueError:
        return None
    return int(second.timestamp()) * SECOND_NS + int(f"{fraction:0<9}"[:9])


def _degrees(text: str, side: str) -> float:
    """Degrees of ``dddmm.mmmm`` and one of N, S, E, W."""
    value = _number(text)
    degrees = np.floor(value / 100.0)
    return float((degrees + (value - 100.0 * degrees) / 60.0) * (-1.0 if side in ("S", "W") else 1.0))


def _number(text: str) -> float:
    try:
        return float(text) if text else np.nan
    except ValueError:
        return np.nan
