"""What a picture's encoded bytes say of themselves, without decoding them."""

from __future__ import annotations

import struct
from pathlib import PurePath

from mirror.errors import RecordingError

_JPEG_START = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"
_PNG_START = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"IEND\xaeB`\x82"
_TAIL = 1024
_NO_SIZE = {0xC4, 0xC8, 0xCC}


def raster_size(data: bytes, file: str | PurePath) -> tuple[int, int]:
    """Width and height in pixels, from the header of a JPEG (ITU T.81) or PNG (ISO 15948).

    Raises:
        RecordingError: neither, or cut off before its size.
    """
    if data.startswith(_PNG_START) and len(data) >= 24:
        width, height = struct.unpack(">II", data[16:24])
        return int(width), int(height)
    if data.startswith(_JPEG_START):
        position = 2
        while position + 9 <= len(data):
            if data[position] != 0xFF:
                break
            marker = data[position + 1]
            if marker == 0xFF:
                position += 1
                continue
            if 0xC0 <= marker <= 0xCF and marker not in _NO_SIZE:
                height, width = struct.unpack(">HH", data[position + 5 : position + 9])
                return int(width), int(height)
            position += 2 + struct.unpack(">H", data[position + 2 : position + 4])[0]
    raise RecordingError(
        "neither a JPEG nor a PNG, or cut off in its header",
        file=file,
        expected="an encoded picture",
        remedy="restore the file, or take it out of the recording",
    )


def require_whole(data: bytes, file: str | PurePath) -> None:
    """Refuse a picture that is empty, of another kind, or lacks its end marker: a truncated copy.

    Raises:
        RecordingError: naming the file.
    """
    jpeg = data.startswith(_JPEG_START) and data.rfind(_JPEG_END, max(0, len(data) - _TAIL)) >= 0
    png = data.startswith(_PNG_START) and data.rfind(_PNG_END, max(0, len(data) - _TAIL)) >= 0
    if jpeg or png:
        return
    known = data.startswith((_JPEG_START, _PNG_START))
    raise RecordingError(
        f"truncated: {len(data)} bytes and no end marker" if known else "neither a JPEG nor a PNG",
        file=file,
        expected="a whole JPEG or PNG",
        remedy="restore the file, or take it out of the recording",
    )
