"""Metadata of encoded images: what a JPEG (ITU T.81) or PNG (ISO 15948) holds beside its pixels, and its removal.

An image is written again from the parts that decoding needs, by an allow-list (see `jpeg_cleaning` and `png_cleaning`):
what is not needed to decode the same pixels is left out, known or not, wherever it lies.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import PurePath
from typing import NamedTuple

from mirror.dataset.images.jpeg_cleaning import clean_jpeg
from mirror.dataset.images.jpeg_frame import FormatError
from mirror.dataset.images.png_cleaning import START, clean_png, list_chunks
from mirror.errors import DatasetError

_SOI, _EOI, _SOS, _TEM, _APP0, _APP1, _APP2, _APP13, _APP14, _COM = (
    0xD8, 0xD9, 0xDA, 0x01, 0xE0, 0xE1, 0xE2, 0xED, 0xEE, 0xFE,
)  # fmt: skip
_ORIENTATION, _GPS, _THUMBNAIL = 0x0112, 0x8825, 0x0201
_XMP_ORIENTATION = b"tiff:Orientation"


class Segment(NamedTuple):
    """A part of a JPEG.

    Attributes:
        marker: second byte of its marker.
        start: position of the marker.
        end: position after the part; that of an SOS includes the entropy-coded data.
    """

    marker: int
    start: int
    end: int


def list_metadata(data: bytes, file: str | PurePath) -> list[str]:
    """List the metadata of an image by name, sorted.

    Args:
        data: a JPEG or PNG.
        file: for messages.

    Raises:
        DatasetError: it is neither a JPEG nor a PNG, or it is cut short.
    """
    found = _clean(data, file)[1]
    if data.startswith(START):
        for _, _, end in list_chunks(data):
            last = end
    else:
        for segment in segments(data, file):
            found |= _names(segment.marker, data[segment.start + 4 : segment.end])
            last = segment.end
    return sorted(found | ({"bytes after the end"} if last != len(data) else set()))


def strip_metadata(data: bytes, file: str | PurePath) -> bytes:
    """Remove everything that decoding does not need, without changing the decoded pixels.

    Kept are the tables that scans use, the frame and the scans of a JPEG up to its last block, with a JFIF segment
    without thumbnail or the colour transform of an Adobe segment where it had one; the header, the used colours, the
    transparency and the rows of a PNG. Bytes after the end are removed.

    Raises:
        DatasetError: it is neither a JPEG nor a PNG, it is broken or cut short, or it is of a kind that cameras do not
            write, such as a lossless JPEG.
    """
    return _clean(data, file)[0]


def _clean(data: bytes, file: str | PurePath) -> tuple[bytes, set[str]]:
    if not data.startswith((START, b"\xff\xd8")):
        raise _broken(file, "neither a JPEG nor a PNG")
    try:
        return clean_png(data) if data.startswith(START) else clean_jpeg(data)
    except FormatError as error:
        raise _broken(file, str(error)) from error


def read_orientation(data: bytes) -> int:
    """Return the EXIF orientation of a JPEG, 1 to 8; 1 if it is missing or invalid."""
    if not data.startswith(b"\xff\xd8"):
        return 1
    try:
        for segment in segments(data, ""):
            if segment.marker == _APP1 and data[segment.start + 4 : segment.start + 10] == b"Exif\0\0":
                tags = _exif_tags(data[segment.start + 10 : segment.end])
                value = tags.get(_ORIENTATION, 1)
                return value if 1 <= value <= 8 else 1
    except DatasetError:
        return 1
    return 1


def states_orientation(data: bytes) -> bool:
    """Return whether other programs may turn an image: EXIF orientation not 1, or any in XMP or a PNG."""
    if data.startswith(START):
        return b"eXIf" in data or _XMP_ORIENTATION in data
    return read_orientation(data) != 1 or _XMP_ORIENTATION in data


def segments(data: bytes, file: str | PurePath) -> Iterator[Segment]:
    """Yield the segments of a JPEG after its first two bytes, up to its first end marker.

    Raises:
        DatasetError: it is no JPEG, or it ends before its end marker.
    """
    if not data.startswith(b"\xff\xd8"):
        raise _broken(file, "neither a JPEG nor a PNG")
    position = 2
    while True:
        start = position
        while data[position + 1 : position + 2] == b"\xff":
            position += 1
        if position + 2 > len(data):
            raise _broken(file, "truncated: it has no end marker")
        marker = data[position + 1]
        if data[position] != 0xFF or marker in (0x00, _SOI):
            raise _broken(file, f"broken JPEG: no marker at byte {position}")
        if marker == _EOI:
            yield Segment(marker, position, position + 2)
            return
        if marker == _TEM or 0xD0 <= marker <= 0xD7:
            position += 2
            yield Segment(marker, start, position)
            continue
        end = position + 2 + int.from_bytes(data[position + 2 : position + 4])
        if position + 4 > len(data) or end > len(data) or end < position + 4:
            raise _broken(file, "truncated: it has no end marker")
        start, position = position, _end_of_scan(data, end, file) if marker == _SOS else end
        yield Segment(marker, start, position)


def _end_of_scan(data: bytes, start: int, file: str | PurePath) -> int:
    """The position of the first marker after entropy-coded data, in which 0xFF is stuffed or a restart marker."""
    position = start
    while True:
        position = data.find(b"\xff", position)
        if position < 0 or position + 1 >= len(data):
            raise _broken(file, "truncated: it has no end marker")
        following = data[position + 1]
        if following == 0xFF:
            position += 1
        elif following == 0x00 or 0xD0 <= following <= 0xD7:
            position += 2
        else:
            return position


def _names(marker: int, body: bytes) -> set[str]:
    """Name what a segment holds that is no part of the pixels."""
    if marker == _COM:
        return {"comment"}
    if not 0xE0 <= marker <= 0xEF:
        return set()
    if marker == _APP0 and body.startswith(b"JFIF\0"):
        return {"thumbnail"} if len(body) > 14 else set()
    if marker == _APP14 and body.startswith(b"Adobe"):
        return {"Adobe segment"} if len(body) > 12 else set()
    if marker == _APP1 and body.startswith(b"Exif\0\0"):
        tags = _exif_tags(body[6:])
        return {"EXIF", *(["GPS"] if _GPS in tags else []), *(["thumbnail"] if _THUMBNAIL in tags else [])}
    if marker == _APP1:
        return {"XMP"}
    if marker == _APP2 and body.startswith(b"ICC_PROFILE"):
        return {"ICC profile"}
    if marker == _APP13:
        return {"IPTC"}
    return {"thumbnail"} if body.startswith(b"JFXX") else {f"segment APP{marker - 0xE0}"}


def _exif_tags(tiff: bytes) -> dict[int, int]:
    """Tags of the first two directories of EXIF data, with their first value as a 16 or 32 bit number."""
    order = {b"II": "<", b"MM": ">"}.get(tiff[:2])
    tags: dict[int, int] = {}
    if order is None:
        return tags
    try:
        (place,) = struct.unpack_from(f"{order}I", tiff, 4)
        for _ in range(2):
            (count,) = struct.unpack_from(f"{order}H", tiff, place)
            for number in range(count):
                at = place + 2 + 12 * number
                tag, kind = struct.unpack_from(f"{order}HH", tiff, at)
                tags[tag] = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", tiff, at + 8)[0]
            (place,) = struct.unpack_from(f"{order}I", tiff, place + 2 + 12 * count)
            if not place:
                break
    except struct.error:
        # Damaged EXIF data is metadata too, whatever it says.
        return tags
    return tags


def _broken(file: str | PurePath, problem: str) -> DatasetError:
    return DatasetError(
        problem, file=file, expected="a whole JPEG or PNG", remedy="restore the file, or drop the image"
    )
