"""Writes mp4 files with a track of fixes, as cameras of GoPro (GPMF) and by the specification of Google (CAMM) do."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from mirror.recordings.time import SECOND_NS

TIMESCALE = 1000
_EPOCH_S = 2_082_844_800
GPS_MINUS_UNIX_S = 315_964_800 - 18
"""Unix seconds of the epoch of GPS, less the leap seconds since: for stamps after 2017."""


@dataclass(frozen=True)
class Fixes:
    """Fixes of a drive eastward at 10 m/s, 16 a second, by payloads of a second.

    Attributes:
        start_ns: Unix time at which the video begins.
        seconds: number of payloads.
        lost: payloads without a fix.
    """

    start_ns: int = 1_772_359_200_250_000_000
    seconds: int = 12
    lost: tuple[int, ...] = ()
    rate = 16

    @property
    def stamps(self) -> np.ndarray:
        """(N,) Unix nanoseconds."""
        return self.start_ns + np.arange(self.seconds * self.rate) * (SECOND_NS // self.rate)

    @property
    def degrees(self) -> np.ndarray:
        """(N, 3) longitude, latitude, height; NaN: no fix. All are whole in the units of the formats."""
        rows = np.arange(self.seconds * self.rate)
        out = np.stack([11.57 + rows * 84e-7, 48.137 + 0.0 * rows, 520.0 + 0.25 * (rows % 4)], axis=1)
        out[np.isin(rows // self.rate, self.lost)] = np.nan
        return np.asarray(out)

    def of_payload(self, number: int) -> np.ndarray:
        """Rows of a payload; zeros where there is no fix, as cameras write them."""
        return np.nan_to_num(self.degrees[number * self.rate : (number + 1) * self.rate])


def gps5(fixes: Fixes) -> list[bytes]:
    """Payloads of GPMF with times for whole payloads; ``GPSU`` of every third one is 80 ms late."""
    out = []
    for number in range(fixes.seconds):
        lon, lat, height = fixes.of_payload(number).T
        scale = (10**7, 10**7, 1000, 1000, 100)
        rows = np.stack([lat, lon, height, 0 * lat + 10.0, 0 * lat + 10.0], axis=1) * scale
        late = 80_000_000 * (number % 3 == 1)
        stream = _entry(b"STNM", b"c", 1, b"GPS (Lat., Long., Alt., 2D speed, 3D speed)")
        stream += _entry(b"GPSF", b"L", 4, struct.pack(">I", 0 if number in fixes.lost else 3))
        stream += _entry(b"GPSU", b"U", 16, _utc(fixes.start_ns + number * SECOND_NS + late))
        stream += _entry(b"GPSP", b"S", 2, struct.pack(">H", 150))
        stream += _entry(b"SCAL", b"l", 4, np.array(scale, ">i4").tobytes())
        stream += _entry(b"GPS5", b"l", 20, np.rint(rows).astype(">i4").tobytes())
        out.append(_device(stream))
    return out


def gps9(fixes: Fixes, *, beside: bool = True) -> list[bytes]:
    """Payloads of GPMF with a time for each fix, beside or without ``GPS5`` of another time."""
    out = []
    for number, other in enumerate(gps5(Fixes(fixes.start_ns + SECOND_NS, fixes.seconds))):
        lon, lat, height = fixes.of_payload(number).T
        stamps = fixes.stamps[number * fixes.rate : (number + 1) * fixes.rate]
        day, rest = np.divmod(stamps, 86_400 * SECOND_NS)
        rows = np.zeros(len(lon), np.dtype([("numbers", ">i4", 7), ("words", ">u2", 2)]))
        values = [lat * 1e7, lon * 1e7, height * 1e3, 0 * lat + 10_000, 0 * lat + 1000, day - 10_957, rest // 1_000_000]
        rows["numbers"] = np.rint(np.stack(values, axis=1))
        rows["words"] = (120, 0 if number in fixes.lost else 3)
        stream = _entry(b"TYPE", b"c", 1, b"lllllllSS")
        stream += _entry(b"SCAL", b"l", 4, np.array([10**7, 10**7, 1000, 1000, 100, 1, 1000, 100, 1], ">i4").tobytes())
        stream += _entry(b"GPS9", b"?", 32, rows.tobytes())
        out.append(other * beside + _device(stream))
    return out


def camm6(fixes: Fixes, *, unix: bool = False) -> list[bytes]:
    """Samples of CAMM: before each fix with its time, one of a gyroscope; the last of them has two packets."""
    out = []
    for row, stamp in enumerate(fixes.stamps.tolist()):
        lon, lat, height = np.nan_to_num(fixes.degrees[row])
        seconds = stamp / SECOND_NS - (0 if unix else GPS_MINUS_UNIX_S)
        lost = row // fixes.rate in fixes.lost
        fix = struct.pack("<di2d7f", seconds, 0 if lost else 3, lat, lon, height, 3.0, 5.0, 10.0, 0.0, 0.0, 0.5)
        out += [struct.pack("<HH3f", 0, 2, 0.1, 0.2, 0.3), struct.pack("<HH", 0, 6) + fix]
    return [*out[:-2], out[-1], out[-2] + struct.pack("<HH2i", 0, 1, 8_000_000, 20_000_000)]


def camm5(fixes: Fixes) -> list[bytes]:
    """Samples of CAMM, each with a place without a time."""
    return [struct.pack("<HH3d", 0, 5, lat, lon, height) for lon, lat, height in fixes.degrees.tolist()]


def write_video(
    file: Path, name: str, samples: Sequence[bytes], step: int, *, created_ns: int | None = None, wide: bool = False
) -> Path:
    """Write an mp4 with a track of metadata alone, its samples in chunks of three, after a short other track.

    Args:
        file: the file.
        name: format of the track: ``gpmd`` or ``camm``.
        samples: its samples.
        step: duration of a sample in units of 1 / `TIMESCALE`.
        created_ns: Unix time of creation; None: none.
        wide: boxes and offsets of 64 bits.
    """
    head = _box(b"ftyp", b"mp41" + bytes(4) + b"mp41")
    body = b"".join(samples)
    data = (
        struct.pack(">I4sQ", 1, b"mdat", 16 + 4 + len(body)) if wide else struct.pack(">I4s", 12 + len(body), b"mdat")
    )
    first = len(head) + len(data) + 4
    created = 0 if created_ns is None else created_ns // SECOND_NS + _EPOCH_S
    header = _full(struct.pack(">IIII", created, created, TIMESCALE, step * len(samples)) + bytes(80))
    movie = _box(b"mvhd", header) + _track(b"tmcd", [b"tick"], 1, first - 4, wide)
    movie += _track(name.encode(), samples, step, first, wide)
    file.write_bytes(head + data + b"tick" + body + _box(b"free", b"") + _box(b"moov", movie))
    return file


def with_track(video: Path, file: Path, name: str, samples: Sequence[bytes], step: int) -> Path:
    """Write a copy of a video whose index lies at its end, with a track of metadata."""
    data = video.read_bytes()
    position, index = 0, 0
    while position < len(data):
        size, kind = struct.unpack_from(">I4s", data, position)
        index = position if kind == b"moov" else index
        position += size
    assert index and index + struct.unpack_from(">I", data, index)[0] == len(data)
    body = b"".join(samples)
    # The samples lie behind the video's own data, before the index.
    track = _track(name.encode(), samples, step, index + 8, wide=False)
    file.write_bytes(data[:index] + _box(b"mdat", body) + _box(b"moov", data[index + 8 :] + track))
    return file


def _track(name: bytes, samples: Sequence[bytes], step: int, first: int, wide: bool) -> bytes:
    sizes = [len(sample) for sample in samples]
    chunks = [first + sum(sizes[:start]) for start in range(0, len(sizes), 3)]
    rest = len(sizes) % 3
    runs = [(1, 3, 1)] * (len(sizes) >= 3) + [(len(chunks), rest, 1)] * (rest > 0)
    offsets = _full(struct.pack(">I", len(chunks)) + np.array(chunks, ">u8" if wide else ">u4").tobytes())
    same = len(set(sizes)) == 1
    table = struct.pack(">II", sizes[0] if same else 0, len(sizes))
    table += b"" if same else np.array(sizes, ">u4").tobytes()
    description = struct.pack(">I4s6xH", 16, name, 1)
    stbl = b"".join(
        (
            _box(b"stsd", _full(struct.pack(">I", 1) + description)),
            _box(b"stts", _full(struct.pack(">III", 1, len(sizes), step))),
            _box(b"stsc", _full(struct.pack(">I", len(runs)) + np.array(runs, ">u4").tobytes())),
            _box(b"stsz", _full(table)),
            _box(b"co64" if wide else b"stco", offsets),
        )
    )
    media = _box(b"mdhd", _full(struct.pack(">IIIIHH", 0, 0, TIMESCALE, step * len(sizes), 0x55C4, 0)))
    media += _box(b"hdlr", _full(bytes(4) + b"meta" + bytes(12) + b"fixes\0"))
    place = _box(b"dinf", _box(b"dref", _full(struct.pack(">I", 1) + _box(b"url ", b"\0\0\0\1"))))
    media += _box(b"minf", _box(b"nmhd", bytes(4)) + place + _box(b"stbl", stbl))
    head = struct.pack(">IIIII", 0, 0, 2, 0, step * len(sizes)) + bytes(60)
    return _box(b"trak", _box(b"tkhd", b"\0\0\0\7" + head) + _box(b"mdia", media))


def _box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I4s", 8 + len(content), kind) + content


def _full(content: bytes) -> bytes:
    return bytes(4) + content


def _entry(name: bytes, kind: bytes, size: int, data: bytes) -> bytes:
    head = struct.pack(">4sBBH", name, kind[0] if kind else 0, size, len(data) // size)
    return head + data + bytes(-len(data) % 4)


def _device(stream: bytes) -> bytes:
    content = _entry(b"DVID", b"L", 4, struct.pack(">I", 1)) + _entry(b"DVNM", b"c", 1, b"Camera")
    return _entry(b"DEVC", b"", 1, content + _entry(b"STRM", b"", 1, stream))


def _utc(stamp_ns: int) -> bytes:
    time = datetime.fromtimestamp(stamp_ns // SECOND_NS, UTC)
    return f"{time:%y%m%d%H%M%S}.{stamp_ns % SECOND_NS // 1_000_000:03d}".encode()
