"""Reads size and structure of an encoded image without decoding it: JPEG (ITU T.81) and PNG (ISO 15948).

The structure is followed from marker to marker and from chunk to chunk. In a JPEG's entropy-coded data every byte 0xFF
is stuffed or part of a restart marker, so foreign bytes between intact markers are detected; in a PNG every critical
chunk has a checksum. Other damage is detected only by a decoder.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import PurePath
from typing import Final

import numpy as np

from mirror.arrays import Int64
from mirror.errors import RecordingError

TAIL_BYTES: Final = 4096
"""Largest distance of the end marker from the end of an image's bytes: cameras add padding after it."""

MAX_PIXELS: Final = 1 << 28
"""Images with more pixels are not decoded; cameras have up to 1.5 * 10^8."""

CODECS: Final = {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png"}
"""Codec by the suffix of a file's name."""

_STARTS: Final = {"jpeg": b"\xff\xd8", "png": b"\x89PNG\r\n\x1a\n"}
_ENDS: Final = {"jpeg": b"\xff\xd9", "png": b"IEND\xaeB`\x82"}
_SOI, _EOI, _SOS, _TEM = 0xD8, 0xD9, 0xDA, 0x01
_FRAMES: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# Tables, comments and application data; markers below 0xC0 and 0xF0 to 0xFD are reserved.
_SEGMENTS: Final = frozenset((0xC4, 0xCC, *range(0xDB, 0xF0), 0xFE))
# Bytes that form a marker after 0xFF in image data: not a stuffed zero, not a restart marker (eight), not padding.
_ENDS_SCAN: Final = np.array([byte not in (0x00, 0xFF) and not 0xD0 <= byte <= 0xD7 for byte in range(256)])
# Bits per sample that PNG allows, by colour type.
_PNG_DEPTHS: Final = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_LARGEST: Final = 2**31 - 1


class _CutError(Exception):
    """The bytes end before the end of the image."""


class _BrokenError(Exception):
    """The bytes violate the format."""


def read_raster_size(data: bytes, file: str | PurePath) -> tuple[int, int]:
    """Read width and height in pixels from the header; the rest of the file may be missing.

    Raises:
        RecordingError: neither a JPEG nor a PNG, or broken or cut off before its size.
    """
    return _check_structure(data, file, complete=False)


def codec_of_name(file: PurePath) -> str:
    """Return the codec of an image by its name: ``jpeg`` or ``png``.

    Raises:
        RecordingError: the name has another suffix.
    """
    codec = CODECS.get(file.suffix.lower())
    if codec is None:
        raise RecordingError("unknown kind of image", file=file, expected=" or ".join(CODECS))
    return codec


def is_decodable(data: bytes) -> bool:
    """Return whether the header of a JPEG or PNG states a camera's image size, as a small file can hold 10^9 pixels."""
    try:
        width, height = read_raster_size(data, "image")
    except RecordingError:
        return False
    return 0 < width * height <= MAX_PIXELS


def require_complete_image(data: bytes, file: str | PurePath) -> tuple[int, int]:
    """Read width and height in pixels, and check the structure of the image from its start to its end marker.

    Raises:
        RecordingError: it is empty, of another format, truncated, or broken between its markers; the byte is named.
    """
    return _check_structure(data, file, complete=True)


def has_end_marker(data: bytes, codec: str) -> bool:
    """Return whether the last `TAIL_BYTES` of an image contain its end marker; True for other codecs.

    Args:
        data: the encoded bytes, or at least the last `TAIL_BYTES` of them.
        codec: ``jpeg`` or ``png``; other codecs have no such marker.
    """
    end = _ENDS.get(codec)
    return end is None or data.rfind(end, max(0, len(data) - TAIL_BYTES)) >= 0


def _check_structure(data: bytes, file: str | PurePath, *, complete: bool) -> tuple[int, int]:
    codec = next((codec for codec, start in _STARTS.items() if data.startswith(start)), None)
    try:
        if codec is None:
            raise _BrokenError("neither a JPEG nor a PNG")
        size = _check_jpeg(data, complete=complete) if codec == "jpeg" else _check_png(data, complete=complete)
        if complete and not has_end_marker(data, codec):
            raise _BrokenError(f"no end marker in its last {TAIL_BYTES} bytes")
    except (_CutError, _BrokenError) as problem:
        cut = f"truncated: {len(data)} bytes and no end marker" if complete else "cut off in its header"
        raise RecordingError(
            str(problem) if isinstance(problem, _BrokenError) else cut,
            file=file,
            expected="a whole JPEG or PNG",
            remedy="restore the file, or take it out of the recording",
        ) from None
    return size


def _check_jpeg(data: bytes, *, complete: bool) -> tuple[int, int]:
    position, size = 2, None
    markers: Int64 | None = None
    while True:
        while data[position + 1 : position + 2] == b"\xff":
            position += 1
        if position + 2 > len(data):
            raise _CutError
        if data[position] != 0xFF:
            raise _BrokenError(f"broken JPEG: no marker at byte {position}")
        marker = data[position + 1]
        if marker == _EOI:
            if size is None or markers is None:
                raise _BrokenError("broken JPEG: it ends before its image data")
            return size
        if marker == _TEM:
            position += 2
            continue
        if marker not in _SEGMENTS and marker not in _FRAMES and marker != _SOS:
            raise _BrokenError(f"broken JPEG: marker 0x{marker:02X} at byte {position}")
        if position + 4 > len(data):
            raise _CutError
        length = int.from_bytes(data[position + 2 : position + 4])
        end = position + 2 + length
        if end > len(data):
            raise _CutError
        if marker in _FRAMES:
            if size is not None:
                raise _BrokenError(f"broken JPEG: a second frame at byte {position}")
            size = _read_jpeg_frame(data[position + 4 : end], position)
            if not complete:
                return size
        elif length < 2:
            raise _BrokenError(f"broken JPEG: a segment of {length} bytes at byte {position}")
        position = end
        if marker == _SOS:
            if size is None:
                raise _BrokenError(f"broken JPEG: image data before its size at byte {position}")
            if markers is None:
                markers = _find_markers(data, position)
            following = int(np.searchsorted(markers, position))
            if following == len(markers):
                raise _CutError
            position = int(markers[following])


def _find_markers(data: bytes, start: int) -> Int64:
    """Positions of possible markers from a byte on, ascending; one pass over the bytes serves all scans."""
    values = np.frombuffer(data, np.uint8, offset=start) if start < len(data) else np.empty(1, np.uint8)
    escapes = np.flatnonzero(values[:-1] == 0xFF)
    return start + escapes[_ENDS_SCAN[values[1:][escapes]]]


def _read_jpeg_frame(segment: bytes, position: int) -> tuple[int, int]:
    if len(segment) < 6 or len(segment) != 6 + 3 * segment[5]:
        raise _BrokenError(f"broken JPEG: a frame header of {len(segment)} bytes at byte {position}")
    height, width = struct.unpack(">HH", segment[1:5])
    if not width or not height or not segment[5]:
        raise _BrokenError(f"a JPEG of {width} x {height} px and {segment[5]} components")
    return int(width), int(height)


def _check_png(data: bytes, *, complete: bool) -> tuple[int, int]:
    position, size, has_data = len(_STARTS["png"]), None, False
    while True:
        if position + 12 > len(data):
            raise _CutError
        length, kind = struct.unpack(">I4s", data[position : position + 8])
        end = position + 12 + length
        if size is None and (kind != b"IHDR" or length != 13):
            raise _BrokenError("broken PNG: it does not begin with its header")
        if not kind.isalpha() or length > _LARGEST:
            raise _BrokenError(f"broken PNG: no chunk at byte {position}")
        if end > len(data):
            raise _CutError
        # The names of critical chunks begin with an upper-case letter; decoders skip other chunks if they are broken.
        if kind[:1].isupper() and zlib.crc32(memoryview(data)[position + 4 : end - 4]) != int.from_bytes(
            data[end - 4 : end]
        ):
            raise _BrokenError(f"broken PNG: checksum of chunk {kind.decode()} at byte {position}")
        if size is None:
            size = _read_png_header(data[position + 8 : end - 4])
            if not complete:
                return size
        has_data |= kind == b"IDAT"
        if kind == b"IEND":
            if not has_data:
                raise _BrokenError("broken PNG: it ends before its image data")
            return size
        position = end


def _read_png_header(header: bytes) -> tuple[int, int]:
    width, height, depth, colour, compression, filtering, interlace = struct.unpack(">IIBBBBB", header)
    known = depth in _PNG_DEPTHS.get(colour, ()) and compression == filtering == 0 and interlace <= 1
    if not known or not 0 < width <= _LARGEST or not 0 < height <= _LARGEST:
        raise _BrokenError(f"a PNG of {width} x {height} px, {depth} bits, colour type {colour}")
    return int(width), int(height)
