"""A PNG (ISO 15948) with the image and nothing else: header, used palette, transparency and the image's rows.

The rows are compressed again, so that nothing lies between or after the blocks of compressed data. Entries of a palette
that no pixel has, and bits that fill up the bytes of a row, become 0. The pixels are the same.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import UInt8
from mirror.dataset.images.jpeg_frame import FormatError

START: Final = b"\x89PNG\r\n\x1a\n"
_KEPT: Final = frozenset((b"IHDR", b"PLTE", b"IDAT", b"IEND", b"tRNS"))
_CHANNELS: Final = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_DEPTHS: Final = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_ADAM7: Final = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_MOST_PIXELS: Final = 1 << 30
_LEVEL: Final = 6


@dataclass(frozen=True)
class _Header:
    width: int
    height: int
    depth: int
    colour: int
    is_interlaced: bool

    @classmethod
    def parse(cls, body: bytes) -> _Header:
        if len(body) != 13:
            raise FormatError("a header of a wrong length")
        width, height, depth, colour, compression, filters, interlace = struct.unpack(">IIBBBBB", body)
        if depth not in _DEPTHS.get(colour, ()) or compression or filters or interlace > 1:
            raise FormatError("a header with values that do not exist")
        if not width or not height or width * height > _MOST_PIXELS:
            raise FormatError(f"{width} x {height} px in the header")
        return cls(width, height, depth, colour, bool(interlace))

    def passes(self) -> Sequence[tuple[int, int]]:
        """Rows and bytes of a row, without its filter, of each pass that has pixels."""
        grid = _ADAM7 if self.is_interlaced else ((0, 0, 1, 1),)
        found = []
        for left, top, step, down in grid:
            wide, high = -(-(self.width - left) // step), -(-(self.height - top) // down)
            if wide > 0 and high > 0:
                found.append((high, -(-wide * self.bits // 8)))
        return found

    def pixels_of_row(self) -> Sequence[int]:
        """Pixels of a row of each pass that has pixels."""
        grid = _ADAM7 if self.is_interlaced else ((0, 0, 1, 1),)
        counts = [(-(-(self.width - left) // step), -(-(self.height - top) // down)) for left, top, step, down in grid]
        return [wide for wide, high in counts if wide > 0 and high > 0]

    @property
    def bits(self) -> int:
        """Bits of a pixel."""
        return self.depth * _CHANNELS[self.colour]


def list_chunks(data: bytes) -> Iterator[tuple[bytes, int, int]]:
    """Yield the kind, start and end of the chunks of a PNG, up to its end chunk.

    Raises:
        FormatError: it ends before.
    """
    position = len(START)
    while True:
        if position + 12 > len(data):
            raise FormatError("truncated: it has no end marker")
        length, kind = struct.unpack_from(">I4s", data, position)
        end = position + 12 + length
        if end > len(data):
            raise FormatError("truncated: it has no end marker")
        yield kind, position, end
        if kind == b"IEND":
            return
        position = end


def clean_png(data: bytes) -> tuple[bytes, set[str]]:
    """Write a PNG again with its image alone.

    Args:
        data: a PNG.

    Returns:
        The bytes, and what was left out, in words.

    Raises:
        FormatError: the image is broken or cut short.
    """
    found: set[str] = set()
    header, palette, transparency = None, b"", b""
    compressed: list[bytes] = []
    is_over = False
    for kind, start, end in list_chunks(data):
        body = data[start + 8 : end - 4]
        if header is None and kind != b"IHDR":
            raise FormatError("a first chunk that is no header")
        if kind not in _KEPT:
            found.add(f"PNG chunk {kind.decode('ascii', 'replace')}")
        elif kind == b"IHDR" and header is None:
            header = _Header.parse(body)
        elif kind == b"PLTE" and not palette and not compressed:
            palette = body
        elif kind == b"tRNS" and not transparency and not compressed:
            transparency = body
        elif kind == b"IDAT" and not is_over:
            compressed.append(body)
            continue
        elif kind == b"IEND":
            found |= {"bytes in the end chunk"} if body else set()
        else:
            found.add(f"a further PNG chunk {kind.decode()}")
        is_over = is_over or bool(compressed)
    if header is None or not compressed:
        raise FormatError("no image")
    rows = _decompress(b"".join(compressed), sum(high * (1 + wide) for high, wide in header.passes()), found)
    colours = b""
    if header.colour == 3 or header.depth < 8:
        rows, seen = _plain_rows(rows, header, found)
        if header.colour == 3:
            colours = _palette_chunks(palette, transparency, seen, found)
    if header.colour != 3:
        found |= {"a palette of an image without one"} if palette else set()
        colours = _transparency_chunk(transparency, header, found)
    image = zlib.compress(rows, _LEVEL)
    head = struct.pack(
        ">IIBBBBB", header.width, header.height, header.depth, header.colour, 0, 0, int(header.is_interlaced)
    )
    chunks = [_chunk(b"IHDR", head), colours, _chunk(b"IDAT", image), _chunk(b"IEND", b"")]
    return START + b"".join(chunks), found


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _decompress(compressed: bytes, size: int, found: set[str]) -> bytes:
    """The filtered rows; never more than the image has."""
    stream = zlib.decompressobj()
    try:
        rows = stream.decompress(compressed, size)
        if len(rows) < size:
            raise FormatError("truncated: rows are missing")
        if stream.decompress(stream.unconsumed_tail, 1):
            found.add("rows after the last row")
    except zlib.error as error:
        raise FormatError(f"broken compressed data ({error})") from error
    if stream.unused_data:
        found.add("bytes after the compressed data")
    return rows


def _plain_rows(rows: bytes, header: _Header, found: set[str]) -> tuple[bytes, UInt8]:
    """Rows without filters and without bits beyond the last pixel; also returns which values pixels have."""
    from mirror.dataset.images.png_rows import undo_filters

    parts, seen, at = [], np.zeros(256, np.bool_), 0
    for (high, wide), count in zip(header.passes(), header.pixels_of_row()):
        part = np.frombuffer(rows, np.uint8, high * (1 + wide), at).reshape(high, 1 + wide).copy()
        at += part.size
        if not undo_filters(part):
            raise FormatError("a filter of a row that does not exist")
        bits = np.unpackbits(part[:, 1:], axis=1)
        if bits[:, count * header.depth :].any():
            found.add("bits beyond the last pixel of a row")
            bits[:, count * header.depth :] = 0
            part[:, 1:] = np.packbits(bits, axis=1)
        pixels = bits[:, : count * header.depth].reshape(high, count, header.depth)
        seen[np.unique(pixels @ (1 << np.arange(header.depth)[::-1]))] = True
        parts.append(part.tobytes())
    return b"".join(parts), seen.astype(np.uint8)


def _palette_chunks(palette: bytes, transparency: bytes, seen: UInt8, found: set[str]) -> bytes:
    """The palette up to the last colour that a pixel has; other colours are black, and opaque."""
    last = int(np.flatnonzero(seen)[-1])
    if len(palette) % 3 or len(palette) < 3 * (last + 1):
        raise FormatError("a palette without the colours of the pixels")
    colours = np.frombuffer(palette, np.uint8, 3 * (last + 1)).reshape(-1, 3).copy()
    is_free = seen[: last + 1] == 0
    if len(palette) > colours.size or colours[is_free].any():
        found.add("colours of a palette that no pixel has")
    colours[is_free] = 0
    alpha = np.frombuffer(transparency[: last + 1], np.uint8).copy()
    if len(transparency) > len(alpha) or (alpha[is_free[: len(alpha)]] != 255).any():
        found.add("transparency of colours that no pixel has")
    alpha[is_free[: len(alpha)]] = 255
    chunks = _chunk(b"PLTE", colours.tobytes())
    return chunks + (_chunk(b"tRNS", alpha.tobytes()) if len(alpha) else b"")


def _transparency_chunk(transparency: bytes, header: _Header, found: set[str]) -> bytes:
    """The transparent colour of a grey or coloured image."""
    size = {0: 2, 2: 6}.get(header.colour, 0)
    if transparency and len(transparency) != size:
        found.add("a transparency of a wrong length")
        return b""
    return _chunk(b"tRNS", transparency) if transparency else b""
