"""Uncompressed PNGs with a length that depends on the raster only (ISO 15948; RFC 1950 and 1951).

All files end with the same bytes. A reader of the size and the end of a file does not need its pixels.
"""

from __future__ import annotations

import struct
import zlib
from typing import Final

import numpy as np

from mirror.arrays import UInt8
from mirror.recordings.raster import TAIL_BYTES

_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_BLOCK: Final = 65535
_CHUNK: Final = 12
_ZLIB_HEADER: Final = b"\x78\x01"
_NOTE: Final = b"Comment\0A picture of MIRROR's synthetic street, rendered when it was read. What follows is padding."


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


TAIL: Final = _chunk(b"tEXt", _NOTE.ljust(TAIL_BYTES, b" ")) + _chunk(b"IEND", b"")
"""The last bytes of every file; longer than the part that readers search for an end marker."""


def stored_png_length(width_px: int, height_px: int) -> int:
    """Return the number of bytes of the PNG of a raster."""
    raw = height_px * (3 * width_px + 1)
    packed = len(_ZLIB_HEADER) + raw + 5 * -(-raw // _BLOCK) + 4
    return len(_SIGNATURE) + _CHUNK + 13 + _CHUNK + packed + len(TAIL)


def encode_stored_png(bgr: UInt8) -> bytes:
    """Encode an image as an uncompressed PNG.

    Args:
        bgr: (H, W, 3) pixels, blue first.

    Returns:
        `stored_png_length` bytes that end with `TAIL`; the same on every machine for the same pixels.
    """
    height, width = bgr.shape[:2]
    rows = np.zeros((height, 3 * width + 1), np.uint8)
    rows[:, 1:] = bgr[:, :, ::-1].reshape(height, 3 * width)
    raw = rows.tobytes()
    packed = [_ZLIB_HEADER]
    for start in range(0, len(raw), _BLOCK):
        block = raw[start : start + _BLOCK]
        last = start + _BLOCK >= len(raw)
        packed += [struct.pack("<BHH", last, len(block), len(block) ^ 0xFFFF), block]
    packed.append(struct.pack(">I", zlib.adler32(raw)))
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", b"".join(packed)) + TAIL
