"""Fixes in Google's Camera Motion Metadata (CAMM), as developers.google.com/streetview/publish/camm-spec specifies it.

A sample holds packets: two bytes of zero, a type of two bytes, and its numbers, little-endian. Of these types,

- 6 is a fix: seconds since the epoch of GPS (float64), kind of fix (int32; 0: none), latitude, longitude (float64),
  altitude, horizontal and vertical accuracy, velocity east, north and up, its accuracy (float32);
- 5 is latitude, longitude and altitude (float64), at the time of its sample in the video;
- the others hold exposures and the numbers of gyroscopes, accelerometers and magnetometers.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Final

import numpy as np

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.recordings.readers.gpmf import HEIGHTS, video_start_note
from mirror.recordings.readers.mp4_metadata import MetadataTrack
from mirror.recordings.readers.track_files import FileFixes
from mirror.recordings.row_faults import RowFaults
from mirror.recordings.time import GPS_EPOCH_NS, SECOND_NS, ns_from_seconds, unix_from_gps_ns

CLOCKS: Final = ("gps", "unix")
"""Epochs of the fixes' seconds: that of the specification, and that of cameras that write Unix time."""

_FIX: Final = struct.Struct("<di2d7f")
_PLACE: Final = struct.Struct("<3d")
_BYTES: Final = {0: 12, 1: 8, 2: 12, 3: 12, 4: 12, 5: _PLACE.size, 6: _FIX.size, 7: 12}
_LONGEST_S: Final = 4e9
_DAY_NS: Final = 86_400 * SECOND_NS


def read_camm(track: MetadataTrack, clock: str) -> FileFixes:
    """Read the fixes of a track of the format ``camm``.

    Fixes with a time of their own are read where there are any; else places, at the file's time of creation and their
    time in the video.

    Args:
        track: the track.
        clock: one of `CLOCKS`.

    Raises:
        RecordingError: there are no fixes, or no time; or the file's time of creation says that the clock is another.
    """
    fixes, fix_media, places, place_media = [], [], [], []
    torn: list[tuple[int, RecordingError]] = []
    for number, data in enumerate(track.samples):
        try:
            for kind, content in _packets(data):
                if kind == 6:
                    fixes.append(_FIX.unpack(content)[:5])
                    fix_media.append(int(track.start_ns[number]))
                elif kind == 5:
                    places.append(_PLACE.unpack(content))
                    place_media.append(int(track.start_ns[number]))
        except ValueError as problem:
            torn.append((len(fixes) or len(places), _error(track, f"sample {number}", str(problem), "packets of CAMM")))
    if fixes:
        return _with_times(track, np.array(fixes, np.float64), np.array(fix_media, np.int64), torn, clock)
    if not places:
        raise _error(track, f"track {track.format}", "no fixes", "packets of type 5 or 6")
    if track.creation_ns is None:
        raise _error(track, "box mvhd", "the fixes have no date", "fixes of type 6, or a time of creation of the file")
    latitude, longitude, height = np.array(places, np.float64).T
    stamps = np.array(place_media, np.int64) + track.creation_ns
    note = "the fixes have no time: the file's time of creation is taken as the start of the video"
    return FileFixes(stamps, longitude, latitude, height, RowFaults(len(stamps), torn), (HEIGHTS, note))


def _with_times(
    track: MetadataTrack, fixes: np.ndarray, media_ns: Int64, torn: list[tuple[int, RecordingError]], clock: str
) -> FileFixes:
    seconds, kind, latitude, longitude, height = fixes.T
    faults = RowFaults(len(fixes), torn)
    bad = ~((seconds >= 0.0) & (seconds < _LONGEST_S))

    def no_time(row: int) -> RecordingError:
        problem = f"the time {seconds[row]:g} s"
        return _error(track, f"fix {row}", problem, f"seconds since the epoch of {clock.upper()}")

    faults.add(bad, "time", no_time)
    counted = ns_from_seconds(np.where(bad, 0.0, seconds))
    stamps = unix_from_gps_ns(counted) if clock == "gps" else counted
    good = ~bad & (kind != 0)
    # Not numpy's median, which rounds stamps to float64.
    start = int(np.sort((stamps - media_ns)[good])[np.count_nonzero(good) // 2]) if good.any() else None
    if start is not None and track.creation_ns is not None and clock == "gps":
        off, off_as_unix = abs(start - track.creation_ns), abs(start - GPS_EPOCH_NS - track.creation_ns)
        if off_as_unix < 2 * _DAY_NS < off:
            raise _error(
                track,
                "fix 0",
                f"the fixes begin at {np.datetime64(start, 'ns')}, the file was made at"
                f" {np.datetime64(track.creation_ns, 'ns')}",
                "seconds since the epoch of GPS",
                "the camera writes Unix time: --option clock=unix",
            )
    lost = kind == 0
    notes = (HEIGHTS,) if start is None else (HEIGHTS, video_start_note(start))
    east, north, up = (np.where(lost, np.nan, value) for value in (longitude, latitude, height))
    return FileFixes(stamps, east, north, up, faults, notes)


def _packets(data: bytes) -> Iterator[tuple[int, memoryview]]:
    position = 0
    while position < len(data):
        if position + 4 > len(data):
            raise ValueError("a packet is cut off")
        (kind,) = struct.unpack_from("<H", data, position + 2)
        length = _BYTES.get(kind)
        if length is None or position + 4 + length > len(data):
            raise ValueError(f"a packet of type {kind} with {len(data) - position - 4} bytes")
        yield kind, memoryview(data)[position + 4 : position + 4 + length]
        position += 4 + length


def _error(
    track: MetadataTrack, place: str, problem: str, expected: str, remedy: str = "copy the file again from the camera"
) -> RecordingError:
    return RecordingError(problem, file=track.file, place=place, expected=expected, remedy=remedy)
