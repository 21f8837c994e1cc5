"""Fixes in GoPro's metadata format GPMF, as github.com/gopro/gpmf-parser specifies it.

A payload, one a second, is a tree of entries: a name of four letters, a type of one letter, the size of a value and
their number, big-endian, padded to four bytes; the type 0 holds other entries. A stream ``STRM`` in a device ``DEVC``
has the numbers of one sensor, which ``SCAL`` divides:

- ``GPS5`` (to HERO10): latitude, longitude, altitude, two speeds, about 18 a payload, without a time of their own:
  ``GPSU`` is the UTC time of the payload, ``GPSF`` its kind of fix (0: none, 2, 3).
- ``GPS9`` (from HERO11): the same five, days since 2000, seconds since midnight (UTC), dilution of precision, fix.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import RecordingError
from mirror.recordings.readers.mp4_metadata import MetadataTrack
from mirror.recordings.readers.track_files import FileFixes
from mirror.recordings.row_faults import RowFaults
from mirror.recordings.time import SECOND_NS

HEIGHTS: Final = (
    "heights of the camera are taken as ellipsoidal; cameras write heights above sea level too: up to 100 m off, the "
    "same all along"
)
_DAY_S: Final = 86_400
_EPOCH_DAYS: Final = 10_957
"""Days from 1970 to 2000, the epoch of ``GPS9``."""

_LEAST_FIX: Final = 2
_DEPTH: Final = 8
_GPS9: Final = np.dtype([("numbers", ">i4", 7), ("words", ">u2", 2)])
_REMEDY: Final = "copy the file again from the camera"


@dataclass(frozen=True, eq=False)
class _Payload:
    """The fixes of one payload: values (K, 5), and their time where the payload states it."""

    number: int
    values: Float64
    is_fix: Bool
    stamps: Int64 | None
    utc_ns: int | None


def read_gpmf(track: MetadataTrack) -> FileFixes:
    """Read the fixes of a track of the format ``gpmd``.

    A fix of ``GPS5`` has the time of its place in the video, moved to UTC by the median of all payloads with a fix, so
    that errors of single ``GPSU`` do not count. Where there are streams of both kinds, ``GPS9`` is read. Fixes of a
    kind below 2 have no position.

    Raises:
        RecordingError: there are no fixes with a time.
    """
    by_kind: dict[bytes, list[_Payload]] = {b"GPS5": [], b"GPS9": []}
    torn_of: dict[bytes, list[tuple[int, RecordingError]]] = {b"GPS5": [], b"GPS9": []}
    for number, data in enumerate(track.samples):
        try:
            for kind, stream in _streams(data):
                by_kind[kind].append(_read_stream(number, kind, stream))
        except (struct.error, ValueError, LookupError, OverflowError) as problem:
            error = RecordingError(
                f"the payload is broken ({problem!s:.80})",
                file=track.file,
                place=f"payload {number}",
                expected="entries of GPMF",
                remedy=_REMEDY,
            )
            for kind, payloads in by_kind.items():
                torn_of[kind].append((sum(len(one.values) for one in payloads), error))
    kind = b"GPS9" if any(len(one.values) for one in by_kind[b"GPS9"]) else b"GPS5"
    payloads, torn = [one for one in by_kind[kind] if len(one.values)], torn_of[kind]
    media_ns = _media_times(track, payloads)
    known = [
        one.stamps[0] - media[0] for one, media in zip(payloads, media_ns) if one.stamps is not None and one.is_fix[0]
    ]
    known += [one.utc_ns - media[0] for one, media in zip(payloads, media_ns) if one.utc_ns is not None]
    if not known:
        raise RecordingError(
            "no fix with a time" if payloads else "no fixes",
            file=track.file,
            place=f"track {track.format}",
            expected="GPS9, or GPS5 with GPSU and a fix",
            remedy="take the track of another receiver, or switch GPS on in the camera and wait for a fix",
        )
    # Not numpy's median, which rounds stamps to float64.
    start_ns = int(sorted(known)[len(known) // 2])
    stamps = [media + start_ns if one.stamps is None else one.stamps for one, media in zip(payloads, media_ns)]
    values, is_fix = np.concatenate([one.values for one in payloads]), np.concatenate([one.is_fix for one in payloads])
    faults = RowFaults(len(values), torn)
    latitude, longitude, height = (np.where(is_fix, values[:, axis], np.nan) for axis in range(3))
    return FileFixes(np.concatenate(stamps), longitude, latitude, height, faults, (HEIGHTS, video_start_note(start_ns)))


def video_start_note(start_ns: int) -> str:
    """Return the note that says when the video begins by the fixes in it."""
    text = f"{np.datetime64(start_ns // 1_000, 'us')}Z"
    return f"the video begins at {text} by its fixes; for its images: --start CAMERA={text}"


def _media_times(track: MetadataTrack, payloads: list[_Payload]) -> list[Int64]:
    """Times of the fixes since the start of the video: evenly within their payload."""
    out = []
    for one in payloads:
        start, length = int(track.start_ns[one.number]), int(track.duration_ns[one.number])
        out.append(start + np.arange(len(one.values)) * length // len(one.values))
    return out


def _entries(data: memoryview) -> Iterator[tuple[bytes, int, int, memoryview]]:
    """Name, type, number of values and bytes of each entry."""
    position = 0
    while position + 8 <= len(data):
        name, kind, size, count = struct.unpack_from(">4sBBH", data, position)
        length = size * count
        if name == b"\0\0\0\0":
            return
        if position + 8 + length > len(data):
            raise ValueError(f"an entry of {length} bytes where {len(data) - position - 8} are left")
        yield name, kind, count, data[position + 8 : position + 8 + length]
        position += 8 + (length + 3) // 4 * 4


def _streams(data: bytes) -> Iterator[tuple[bytes, dict[bytes, tuple[int, int, memoryview]]]]:
    """The streams of fixes in a payload, with their kind."""
    pending = [(memoryview(data), 0)]
    while pending:
        content, depth = pending.pop(0)
        found: dict[bytes, tuple[int, int, memoryview]] = {}
        for name, kind, count, value in _entries(content):
            if kind == 0 and depth < _DEPTH:
                pending.append((value, depth + 1))
            else:
                found[name] = (kind, count, value)
        for name in (b"GPS5", b"GPS9"):
            if name in found:
                yield name, found


def _read_stream(number: int, kind: bytes, stream: dict[bytes, tuple[int, int, memoryview]]) -> _Payload:
    scale = np.frombuffer(stream[b"SCAL"][2], ">i4").astype(np.float64)
    if len(scale) != (5 if kind == b"GPS5" else 9) or (scale == 0.0).any():
        raise ValueError(f"SCAL of {len(scale)} numbers")
    data = stream[kind][2]
    if kind == b"GPS5":
        values = np.frombuffer(data, ">i4").reshape(-1, 5) / scale
        fix = int.from_bytes(stream[b"GPSF"][2][:4])
        text = bytes(stream[b"GPSU"][2]).decode("ascii") if b"GPSU" in stream else ""
        is_fix: Bool = np.full(len(values), fix >= _LEAST_FIX)
        return _Payload(number, values, is_fix, None, _unix_ns(text) if fix >= _LEAST_FIX else None)
    rows = np.frombuffer(data, _GPS9)
    numbers = np.concatenate([rows["numbers"], rows["words"]], axis=1) / scale
    days, seconds, fix_of = numbers[:, 5], numbers[:, 6], numbers[:, 8]
    if not ((days >= 0) & (days < 2**15) & (seconds >= 0) & (seconds <= _DAY_S)).all():
        raise ValueError(f"a fix at day {days[0]:g} and second {seconds[0]:g}")
    milliseconds = np.rint(seconds * 1_000).astype(np.int64)
    stamps = (days.astype(np.int64) + _EPOCH_DAYS) * (_DAY_S * SECOND_NS) + milliseconds * 1_000_000
    return _Payload(number, numbers[:, :5], fix_of >= _LEAST_FIX, stamps, None)


def _unix_ns(text: str) -> int | None:
    """Unix nanoseconds of ``yymmddhhmmss.sss``; None: there are none."""
    whole, _, fraction = text.strip("\0 ").partition(".")
    if not whole:
        return None
    if len(whole) != 12 or not (whole + fraction).isdecimal():
        raise ValueError(f"GPSU is {text!r}")
    numbers = [int(whole[index : index + 2]) for index in range(0, 12, 2)]
    second = datetime(2000 + numbers[0], *numbers[1:], tzinfo=UTC)  # type: ignore[misc,arg-type]
    return int(second.timestamp()) * SECOND_NS + int(f"{fraction:0<9}"[:9])
