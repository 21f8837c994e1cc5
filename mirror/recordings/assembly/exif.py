"""The time at which a camera took a JPEG, from its EXIF data (CIPA DC-008)."""

from __future__ import annotations

import struct
from typing import Final

_EXIF_DIRECTORY: Final = 0x8769
_TIME, _FRACTION, _OFFSET = 0x9003, 0x9291, 0x9011
_TEXT: Final = 2
_MOST_ENTRIES: Final = 512


def read_exif_time(data: bytes) -> str | None:
    """Return ``2026-03-01 10:00:00.123 +01:00`` of a JPEG, as far as its EXIF data states it; else None.

    Args:
        data: the first 64 KiB of the file or more: the EXIF data is in a segment before the image.
    """
    at = 2
    while data.startswith(b"\xff\xd8") and at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != 0xDA:
        length = int.from_bytes(data[at + 2 : at + 4])
        if data[at + 1] == 0xE1 and data[at + 4 : at + 10] == b"Exif\0\0":
            return _time(data[at + 10 : at + 2 + length])
        at += 2 + length
    return None


def _time(tiff: bytes) -> str | None:
    order = {b"II": "<", b"MM": ">"}.get(tiff[:2])
    if order is None:
        return None
    try:
        (first,) = struct.unpack_from(f"{order}I", tiff, 4)
        texts = _texts(tiff, order, _values(tiff, order, first).get(_EXIF_DIRECTORY, (0, 0, 0))[2])
    except struct.error:
        # A damaged directory states no time.
        return None
    stamp = texts.get(_TIME, "")
    if len(stamp) != 19 or not stamp.replace(":", "").replace(" ", "").isdecimal():
        return None
    fraction, offset = texts.get(_FRACTION, ""), texts.get(_OFFSET, "")
    text = f"{stamp[:10].replace(':', '-')} {stamp[11:]}" + (f".{fraction[:9]}" if fraction.isdecimal() else "")
    return f"{text} {offset}" if offset[:1] in ("+", "-") else text


def _values(tiff: bytes, order: str, place: int) -> dict[int, tuple[int, int, int]]:
    """Kind, count and value of each tag of a directory."""
    if not place:
        return {}
    (count,) = struct.unpack_from(f"{order}H", tiff, place)
    entries = (struct.unpack_from(f"{order}HHII", tiff, place + 2 + 12 * n) for n in range(min(count, _MOST_ENTRIES)))
    return {tag: (kind, number, value) for tag, kind, number, value in entries}


def _texts(tiff: bytes, order: str, place: int) -> dict[int, str]:
    """The texts of a directory, by tag."""
    texts = {}
    for tag, (kind, count, value) in _values(tiff, order, place).items():
        if kind == _TEXT and tag in (_TIME, _FRACTION, _OFFSET):
            # A text of up to four bytes stands in the place of the offset.
            raw = struct.pack(f"{order}I", value)[:count] if count <= 4 else tiff[value : value + count]
            texts[tag] = raw.split(b"\0")[0].decode("ascii", errors="replace").strip()
    return texts
