"""PNG files of submissions: header and checksums are verified before any pixel is decoded."""

from __future__ import annotations

import struct
import zlib
from typing import Final

import numpy as np

from mirror.arrays import UInt8
from mirror.errors import MirrorError

_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_HEADER: Final = struct.Struct(">IIBBBBB")
_SRGB_GAMMA: Final = 45455
_ALLOWED: Final = {b"IHDR", b"IDAT", b"IEND", b"sRGB", b"gAMA", b"cHRM", b"pHYs", b"tEXt", b"tIME", b"bKGD", b"sBIT"}
_COLOURS: Final = {0: "grey", 2: "RGB", 3: "palette", 4: "grey with alpha", 6: "RGB with alpha"}
_SLACK_BYTES: Final = 65_536
HEADER_BYTES: Final = len(_SIGNATURE) + 8 + _HEADER.size


class RenderError(MirrorError):
    """A render that is damaged or does not have the requested format or size."""


def max_png_bytes(width_px: int, height_px: int) -> int:
    """Return an upper bound on the bytes of a PNG of this size: uncompressed pixels, and room for other chunks."""
    raw = (3 * width_px + 1) * height_px
    return raw + raw // 50 + _SLACK_BYTES


def png_size(data: bytes) -> tuple[int, int] | None:
    """Read width and height from a PNG's header; None if the data is not a PNG."""
    if len(data) < HEADER_BYTES or not data.startswith(_SIGNATURE) or data[12:16] != b"IHDR":
        return None
    width, height = struct.unpack(">II", data[16:24])
    return int(width), int(height)


def find_png_problem(data: bytes) -> str | None:
    """Find the first problem of a PNG other than its size; None if the PNG is valid.

    The checksum of every chunk is verified; nothing is decompressed. Only 8-bit RGB in sRGB is accepted: no alpha,
    palette, interlacing, animation, colour profile or compressed text.
    """
    if png_size(data) is None:
        return "not a PNG" if not data.startswith(_SIGNATURE) else "cut off in its header"
    _, _, depth, colour, compression, filtering, interlacing = _HEADER.unpack(data[16 : 16 + _HEADER.size])
    if (depth, colour) != (8, 2):
        return f"{depth} bit {_COLOURS.get(colour, 'unknown')}, not 8 bit RGB"
    if (compression, filtering, interlacing) != (0, 0, 0):
        return "interlaced, or of an unknown compression"
    view, position, data_chunks = memoryview(data), len(_SIGNATURE), 0
    while position + 12 <= len(data):
        length, kind = struct.unpack(">I4s", data[position : position + 8])
        end = position + 12 + length
        if end > len(data):
            return f"cut off in its chunk {_printable(kind)}"
        if struct.unpack(">I", data[end - 4 : end])[0] != zlib.crc32(view[position + 4 : end - 4]):
            return f"the checksum of its chunk {_printable(kind)} is wrong"
        if kind not in _ALLOWED:
            return f"has a chunk {_printable(kind)}, which is not allowed"
        if kind == b"gAMA" and data[position + 8 : position + 12] != struct.pack(">I", _SRGB_GAMMA):
            return "its gamma is not that of sRGB"
        data_chunks += kind == b"IDAT"
        position = end
        if kind == b"IEND":
            if position != len(data):
                return f"{len(data) - position} bytes after its end"
            return None if data_chunks else "without pixels"
    return "cut off: the chunk IEND is missing"


def decode_render(data: bytes, width_px: int, height_px: int, path: str) -> UInt8:
    """Decode a PNG of a known size to pixels (H, W, 3), RGB.

    Args:
        data: bytes of the PNG.
        width_px: expected width.
        height_px: expected height.
        path: file name for error messages.

    Raises:
        RenderError: the PNG is damaged, or has another size.
    """
    import cv2

    size, problem = png_size(data), find_png_problem(data)
    if problem is None and size != (width_px, height_px):
        problem = f"has another size: {size}"
    if problem is None:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB)
        if pixels is not None and pixels.shape == (height_px, width_px, 3):
            return np.asarray(pixels, np.uint8)
        problem = "cannot be decoded"
    raise RenderError(problem, file=path, expected=f"a PNG of {width_px} x {height_px} px, sRGB, 8 bit")


def encode_png(pixels: UInt8) -> bytes:
    """Encode RGB pixels (H, W, 3) or a mask (H, W), uint8, as a PNG."""
    import cv2

    stored = pixels[..., ::-1] if pixels.ndim == 3 else pixels
    return bytes(cv2.imencode(".png", stored, [cv2.IMWRITE_PNG_COMPRESSION, 3])[1])


def _printable(kind: bytes) -> str:
    return kind.decode("ascii", "replace") if kind.isalpha() else repr(kind)
