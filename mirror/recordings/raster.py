"""What a picture's encoded bytes say of themselves, without decoding them."""

from __future__ import annotations

import struct
from pathlib import PurePath
from typing import Final

from mirror.errors import RecordingError

TAIL_BYTES: Final = 4096
"""How far from the end of a picture's bytes its end marker may be: cameras pad behind it."""

_STARTS: Final = {"jpeg": b"\xff\xd8", "png": b"\x89PNG\r\n\x1a\n"}
_ENDS: Final = {"jpeg": b"\xff\xd9", "png": b"IEND\xaeB`\x82"}
_NO_SIZE: Final = {0xC4, 0xC8, 0xCC}


def raster_size(data: bytes, file: str | PurePath) -> tuple[int, int]:
    """Width and height in pixels, from the header of a JPEG (ITU T.81) or PNG (ISO 15948).

    Raises:
        RecordingError: neither, or cut off before its size.
    """
    if data.startswith(_STARTS["png"]) and len(data) >= 24:
        width, height = struct.unpack(">II", data[16:24])
        return int(width), int(height)
    if data.startswith(_STARTS["jpeg"]):
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


def has_end(data: bytes, codec: str) -> bool:
    """Whether a picture's bytes, or the last `TAIL_BYTES` of them, have its end marker; True for other codecs.

    Args:
        data: the encoded bytes.
        codec: ``jpeg`` or ``png``; another has no such marker.
    """
    end = _ENDS.get(codec)
    return end is None or data.rfind(end, max(0, len(data) - TAIL_BYTES)) >= 0


def require_whole(data: bytes, file: str | PurePath) -> None:
    """Refuse a picture that is empty, of another kind, or lacks its end marker: a truncated copy.

    Raises:
        RecordingError: naming the file.
    """
    codec = next((codec for codec, start in _STARTS.items() if data.startswith(start)), None)
    if codec is not None and has_end(data, codec):
        return
    raise RecordingError(
        f"truncated: {len(data)} bytes and no end marker" if codec is not None else "neither a JPEG nor a PNG",
        file=file,
        expected="a whole JPEG or PNG",
        remedy="restore the file, or take it out of the recording",
    )
