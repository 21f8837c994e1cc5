"""Reads the samples of a track of timed metadata in an mp4 or mov file, without a decoder.

The structure is that of the ISO base media file format (ISO/IEC 14496-12): nested boxes of a size and a name of four
letters. ``moov`` holds a ``trak`` for each track; its sample table ``stbl`` says the format (``stsd``), the durations
(``stts``), sizes (``stsz``), and places (``stsc``, and ``stco`` or ``co64``) of the samples.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.recordings.opening import unreadable_error
from mirror.recordings.time import SECOND_NS

# From the epoch of the format, 1904, to that of Unix.
_EPOCH_S: Final = 2_082_844_800
_LARGEST_INDEX: Final = 2**28
_LARGEST_NS: Final = 2**62
_CONTAINERS: Final = frozenset((b"moov", b"trak", b"mdia", b"minf", b"stbl"))

Boxes = dict[bytes, list[memoryview]]


@dataclass(frozen=True, eq=False)
class MetadataTrack:
    """A track of timed metadata.

    Attributes:
        file: the file.
        format: four letters, such as ``gpmd``.
        creation_ns: Unix time that the file states as its creation; None: it states none.
        start_ns: (N,) start of each sample since the start of the track.
        duration_ns: (N,) its duration.
        samples: N bytes.
    """

    file: Path
    format: str
    creation_ns: int | None
    start_ns: Int64
    duration_ns: Int64
    samples: list[bytes]


def find_metadata_format(file: Path, formats: Collection[str]) -> str | None:
    """Return the format of the first track that has one of some formats; None: there is none, or the file is broken."""
    try:
        with file.open("rb") as opened:
            movie = _read_movie(file, opened)
        return next((name for trak in movie[b"trak"] if (name := _format(_boxes(trak))) in formats), None)
    except (OSError, RecordingError, struct.error, ValueError, LookupError):
        return None


def read_metadata_track(file: Path, formats: Collection[str]) -> MetadataTrack:
    """Read the first track that has one of some formats.

    Args:
        file: an mp4 or mov file.
        formats: four letters each.

    Raises:
        RecordingError: the file is unreadable or broken, or has no such track.
    """
    try:
        with file.open("rb") as opened:
            movie = _read_movie(file, opened)
            for number, trak in enumerate(movie.get(b"trak", [])):
                try:
                    boxes = _boxes(trak)
                    name = _format(boxes)
                    if name in formats:
                        return _read_track(file, opened, name, boxes, _creation_ns(movie))
                except (struct.error, ValueError, LookupError, OverflowError) as problem:
                    raise _broken(file, f"track {number}", f"its sample table is broken ({problem})") from problem
    except OSError as error:
        raise unreadable_error(file, error) from error
    raise RecordingError(
        f"no track of the format {' or '.join(formats)}",
        file=file,
        expected="a video whose camera writes its fixes into it",
        remedy="name the file that the camera wrote: edited and shared videos lose this track",
    )


def _broken(file: Path, place: str, problem: str) -> RecordingError:
    return RecordingError(
        problem,
        file=file,
        place=place,
        expected="a complete mp4 or mov file",
        remedy="copy the file again from the camera",
    )


def _read_movie(file: Path, opened: BinaryIO) -> Boxes:
    """The boxes in ``moov``, which lies among the boxes of the file."""
    size = opened.seek(0, 2)
    position = 0
    while position + 8 <= size:
        opened.seek(position)
        header = opened.read(16)
        length, kind = struct.unpack_from(">I4s", header)
        start = 8
        if length == 1 and len(header) == 16:
            (length,), start = struct.unpack_from(">Q", header, 8), 16
        elif length == 0:
            length = size - position
        if length < start or position + length > size:
            raise _broken(file, f"byte {position}", f"a box of {length} bytes in a file of {size}")
        if kind == b"moov":
            if length > _LARGEST_INDEX:
                raise _broken(file, f"byte {position}", f"an index of {length} bytes")
            opened.seek(position + start)
            try:
                return _boxes(memoryview(opened.read(length - start)))
            except struct.error as problem:
                raise _broken(file, f"byte {position}", f"its index is broken ({problem})") from problem
        position += length
    raise _broken(file, "box moov", "the file has no index")


def _boxes(data: memoryview, depth: int = 0) -> Boxes:
    """The boxes in a box by name; those in containers other than ``trak`` are among them."""
    if depth > len(_CONTAINERS):
        raise struct.error("boxes are nested too deep")
    found: Boxes = {}
    for kind, content in _split(data):
        found.setdefault(kind, []).append(content)
        if kind in _CONTAINERS and kind != b"trak":
            for name, inner in _boxes(content, depth + 1).items():
                found.setdefault(name, []).extend(inner)
    return found


def _split(data: memoryview) -> Iterator[tuple[bytes, memoryview]]:
    position = 0
    while position + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, position)
        start = 8
        if length == 1:
            (length,), start = struct.unpack_from(">Q", data, position + 8), 16
        elif length == 0:
            length = len(data) - position
        if length < start or position + length > len(data):
            raise struct.error(f"a box of {length} bytes where {len(data) - position} are left")
        yield kind, data[position + start : position + length]
        position += length


def _format(boxes: Boxes) -> str:
    """The format of a track by its first sample description."""
    return bytes(boxes[b"stsd"][0][12:16]).decode("latin-1")


def _creation_ns(movie: Boxes) -> int | None:
    header = movie[b"mvhd"][0]
    (created,) = struct.unpack_from(">Q" if header[0] == 1 else ">I", header, 4)
    return (created - _EPOCH_S) * SECOND_NS if _EPOCH_S < created < 2**33 else None


def _read_track(file: Path, opened: BinaryIO, name: str, boxes: Boxes, creation_ns: int | None) -> MetadataTrack:
    header = boxes[b"mdhd"][0]
    (timescale,) = struct.unpack_from(">I", header, 20 if header[0] == 1 else 12)
    offsets, sizes = _places(boxes, opened.seek(0, 2))
    steps = _durations(boxes[b"stts"][0], len(sizes))
    if timescale == 0:
        raise ValueError("a time scale of 0")
    ends = [0]
    for step in steps.tolist():
        ends.append(ends[-1] + step)
    nanoseconds = [end * SECOND_NS // timescale for end in ends]
    if nanoseconds[-1] > _LARGEST_NS:
        raise ValueError("durations of centuries")
    samples = []
    for offset, size in zip(offsets.tolist(), sizes.tolist()):
        opened.seek(offset)
        samples.append(opened.read(size))
    bounds = np.array(nanoseconds, np.int64)
    return MetadataTrack(file, name, creation_ns, bounds[:-1], np.diff(bounds), samples)


def _places(boxes: Boxes, file_size: int) -> tuple[Int64, Int64]:
    """Offset and size of each sample."""
    table = boxes[b"stsz"][0]
    same, count = struct.unpack_from(">II", table, 4)
    if same:
        if same * count > file_size:
            raise ValueError(f"{count} samples of {same} bytes in a file of {file_size}")
        sizes: Int64 = np.full(count, same, np.int64)
    else:
        sizes = np.frombuffer(table, ">u4", count, 12).astype(np.int64)
    wide = b"co64" in boxes
    chunks = boxes[b"co64" if wide else b"stco"][0]
    (chunk_count,) = struct.unpack_from(">I", chunks, 4)
    starts = np.frombuffer(chunks, ">u8" if wide else ">u4", chunk_count, 8)
    if (starts > file_size).any() or int(sizes.sum()) > file_size:
        raise ValueError("samples beyond the end of the file")
    layout = boxes[b"stsc"][0]
    (runs,) = struct.unpack_from(">I", layout, 4)
    first, in_chunk, _ = np.frombuffer(layout, ">u4", 3 * runs, 8).astype(np.int64).reshape(-1, 3).T
    if not runs or first[0] != 1 or (np.diff(first) <= 0).any() or first[-1] > chunk_count:
        raise ValueError("no order of its chunks")
    per_chunk = np.repeat(in_chunk, np.diff([*first.tolist(), chunk_count + 1]))
    if sum(per_chunk.tolist()) != count:
        raise ValueError(f"{sum(per_chunk.tolist())} samples in its chunks, {count} sizes")
    chunk = np.repeat(np.arange(chunk_count), per_chunk)
    before = np.cumsum(sizes) - sizes
    first_of_chunk = np.cumsum(per_chunk) - per_chunk
    offsets = starts.astype(np.int64)[chunk] + before - before[first_of_chunk[chunk]]
    if count and int((offsets + sizes).max()) > file_size:
        raise ValueError("samples beyond the end of the file")
    return offsets, sizes


def _durations(table: memoryview, count: int) -> Int64:
    (runs,) = struct.unpack_from(">I", table, 4)
    repeats, steps = np.frombuffer(table, ">u4", 2 * runs, 8).astype(np.int64).reshape(-1, 2).T
    if sum(repeats.tolist()) != count:
        raise ValueError(f"durations of {sum(repeats.tolist())} samples, {count} sizes")
    return np.repeat(steps, repeats)
