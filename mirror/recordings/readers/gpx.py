"""Reads tracks in GPX 1.0 and 1.1 (GPS Exchange Format, www.topografix.com/gpx.asp)."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import numpy as np

from mirror.arrays import Bool
from mirror.errors import RecordingError
from mirror.recordings.opening import read_file
from mirror.recordings.readers.track_files import FileFixes, TrackRecording, require_track_file
from mirror.recordings.row_faults import RowFaults

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND: Final = timedelta(microseconds=1)
_NO_GEOID: Final = (
    "heights (ele) are above mean sea level by GPX, and are taken as ellipsoidal: up to 100 m off, the same all along"
)


class GpxReader:
    """A reader of a GPX file as one drive."""

    name = "gpx"
    expects = "a file *.gpx with track points that have times"

    def recognises(self, path: Path) -> bool:
        """Return whether a file has the suffix ``.gpx``."""
        return path.is_file() and path.suffix.lower() == ".gpx"

    def open(self, path: Path, options: Mapping[str, str]) -> TrackRecording:
        """Open a file; the options ``drive_id``, ``vehicle_id`` and ``vehicle_type`` name the drive."""
        require_track_file(path, options, self.name, self.expects)
        return TrackRecording(path, "UTC (GPX)", dict(options), _read(path))


def _read(file: Path) -> FileFixes:
    data = read_file(file)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise RecordingError("the file declares entities", file=file, expected="plain GPX", remedy="remove the DOCTYPE")
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        line, column = error.position
        raise RecordingError(
            "the file is not XML", file=file, place=f"line {line}, column {column}", expected="GPX 1.0 or 1.1",
            remedy="copy the file again: a truncated file ends before its last tag",
        ) from error  # fmt: skip
    points = [element for element in root.iter() if element.tag.rpartition("}")[2] == "trkpt"]
    if not points:
        raise RecordingError(
            "no track points (trkpt)", file=file, expected="a track", remedy="record a track, not a route or waypoints"
        )
    rows = [_point(point) for point in points]
    stamps = np.array([0 if row[0] is None else row[0] for row in rows], np.int64)
    numbers = np.array([row[1:] for row in rows], np.float64)
    untimed: Bool = np.array([row[0] is None for row in rows])
    if untimed.all():
        raise RecordingError(
            "no track point has a time", file=file, expected="an element time in every trkpt",
            remedy="export the track as recorded: planned and shared routes have no times",
        )  # fmt: skip
    faults = RowFaults(len(rows))
    faults.add(
        untimed,
        "time",
        lambda row: RecordingError(
            "no time", file=file, place=f"track point {row + 1}", expected="2026-03-01T10:00:00Z"
        ),
    )
    longitude, latitude, elevation, separation = numbers.T
    has_geoid = np.isfinite(separation)
    notes = (_NO_GEOID,) if (np.isfinite(elevation) & ~has_geoid).any() else ()
    height = elevation + np.where(has_geoid, separation, 0.0)
    return FileFixes(stamps, longitude, latitude, height, faults, notes)


def _point(point: ElementTree.Element) -> tuple[int | None, float, float, float, float]:
    """Time in Unix nanoseconds, longitude, latitude, elevation and separation of the geoid of a track point."""
    texts = {child.tag.rpartition("}")[2]: (child.text or "").strip() for child in point}
    return (
        _unix_ns(texts.get("time", "")),
        _number(point.get("lon")),
        _number(point.get("lat")),
        _number(texts.get("ele")),
        _number(texts.get("geoidheight")),
    )


def _unix_ns(text: str) -> int | None:
    """A time of XML Schema, UTC where it states no offset, as GPX has it; None: it is none."""
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        return None
    time = time if time.tzinfo is not None else time.replace(tzinfo=UTC)
    return (time - _EPOCH) // _MICROSECOND * 1000


def _number(text: str | None) -> float:
    try:
        return float(text) if text else np.nan
    except ValueError:
        return np.nan
