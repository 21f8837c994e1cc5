"""A JPEG with the image and nothing else: its segments are written again from what decoding needs.

Markers are chosen by an allow-list. Tables are kept where a scan uses them; codes that no block uses get fixed symbols.
Entropy-coded data are copied up to the last block of the image, and of each restart interval. So the pixels are the
same, and no other bytes are left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, TypeAlias

import numpy as np

from mirror.arrays import Int64, UInt8
from mirror.dataset.images.jpeg_frame import Component, FormatError, JpegFrame, ScanHeader

JFIF: Final = bytes.fromhex("ffe000104a46494600010100000100010000")
"""An APP0 segment without a thumbnail: it says that the components are Y, Cb and Cr."""
_SOI, _EOI, _SOS, _DQT, _DHT, _DRI, _APP0, _APP14 = 0xD8, 0xD9, 0xDA, 0xDB, 0xC4, 0xDD, 0xE0, 0xEE
_FRAMES: Final = frozenset((0xC0, 0xC1, 0xC2))
_OTHER_FRAMES: Final = frozenset((0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF))
_UNUSED: Final = "a table that no scan uses"
_DC_SYMBOLS: Final = bytes(range(12))

HuffmanTable: TypeAlias = tuple[bytes, bytes]
"""Number of codes of each length from 1 to 16, and the symbols in the order of their codes."""


@dataclass
class _Decoder:
    """State of a decoder that reads the segments of an image.

    Attributes:
        found: what the image holds beside its pixels, in words.
        parts: the segments that are written.
        frame: the frame; None: it has not come yet.
        tables: Huffman tables by class (0 DC, 1 AC) and number.
        quantisation: quantisation tables by number.
        interval: restart interval.
        written_interval: the restart interval that was written last.
        jfif: whether there is a JFIF segment.
        transform: colour transform of the Adobe segment; None: there is none.
        latched: components whose quantisation tables are written.
        waiting: Huffman tables (class and number) and quantisation tables (2 and number) that no scan has used yet.
    """

    found: set[str] = field(default_factory=set)
    parts: list[bytes] = field(default_factory=list)
    frame: JpegFrame | None = None
    frame_segment: bytes = b""
    tables: dict[tuple[int, int], HuffmanTable] = field(default_factory=dict)
    quantisation: dict[int, bytes] = field(default_factory=dict)
    interval: int = 0
    written_interval: int = 0
    jfif: bool = False
    transform: int | None = None
    latched: set[int] = field(default_factory=set)
    waiting: set[tuple[int, int]] = field(default_factory=set)

    def define(self, key: tuple[int, int]) -> None:
        """Note that a table is defined."""
        if key in self.waiting:
            self.found.add(_UNUSED)
        self.waiting.add(key)


def clean_jpeg(data: bytes) -> tuple[bytes, set[str]]:
    """Write a JPEG again with its image alone.

    Args:
        data: a JPEG that begins with its start marker.

    Returns:
        The bytes, and what was left out beside application segments and comments, in words.

    Raises:
        FormatError: the image is broken or cut short, or of a kind that cameras do not write: lossless, arithmetic,
            hierarchical or of more than 8 bits.
    """
    decoder = _Decoder()
    position = 2
    while True:
        start = position
        while data[position : position + 1] == b"\xff" and data[position + 1 : position + 2] == b"\xff":
            position += 1
        if position + 2 > len(data):
            raise FormatError("truncated: it has no end marker")
        marker = data[position + 1]
        if data[position] != 0xFF or marker in (0x00, _SOI):
            raise FormatError(f"no marker at byte {start}")
        position += 2
        if marker == _EOI:
            break
        if marker == 0x01 or 0xD0 <= marker <= 0xD7:
            continue
        end = position + int.from_bytes(data[position : position + 2])
        if position + 2 > len(data) or end > len(data) or end < position + 2:
            raise FormatError("truncated: it has no end marker")
        body, position = data[position + 2 : end], end
        if marker == _SOS:
            position = _take_scan(decoder, data, body, position)
            if decoder.frame is not None and decoder.frame.is_complete():
                position = _find_end(decoder, data, position)
                break
        else:
            _take_segment(decoder, marker, body)
    if decoder.frame is None or not decoder.latched:
        raise FormatError("no image")
    if decoder.waiting:
        decoder.found.add(_UNUSED)
    return b"".join([b"\xff\xd8", *_header(decoder), *decoder.parts, b"\xff\xd9"]), decoder.found


def _header(decoder: _Decoder) -> list[bytes]:
    adobe = [] if decoder.transform is None else [_segment(_APP14, b"Adobe\0\x64\0\0\0\0" + bytes([decoder.transform]))]
    return [*([JFIF] if decoder.jfif else []), *adobe]


def _segment(marker: int, body: bytes) -> bytes:
    return bytes((0xFF, marker)) + (len(body) + 2).to_bytes(2) + body


def _take_segment(decoder: _Decoder, marker: int, body: bytes) -> None:
    if marker in _OTHER_FRAMES:
        raise FormatError(f"a frame of kind SOF{marker - 0xC0}, which no camera writes")
    if marker in _FRAMES:
        if decoder.frame is not None:
            raise FormatError("a second frame")
        decoder.frame, decoder.frame_segment = JpegFrame.parse(marker, body), _segment(marker, body)
    elif marker == _DQT:
        _take_quantisation(decoder, body)
    elif marker == _DHT:
        _take_huffman(decoder, body)
    elif marker == _DRI:
        if len(body) != 2:
            raise FormatError("a restart interval of a wrong length")
        decoder.interval = int.from_bytes(body)
    elif marker == _APP0 and body.startswith(b"JFIF\0"):
        decoder.jfif = True
    elif marker == _APP14 and body.startswith(b"Adobe") and len(body) >= 12:
        if decoder.frame is None or not decoder.parts:
            decoder.transform = body[11]
    elif not (0xE0 <= marker <= 0xEF or marker == 0xFE):
        decoder.found.add("a DNL segment" if marker == 0xDC else f"a segment of marker FF{marker:02X}")


def _take_quantisation(decoder: _Decoder, body: bytes) -> None:
    at = 0
    while at < len(body):
        size = 65 if body[at] >> 4 == 0 else 129
        if body[at] >> 4 > 1 or body[at] & 15 > 3 or at + size > len(body):
            raise FormatError("a broken quantisation table")
        decoder.define((2, body[at] & 15))
        decoder.quantisation[body[at] & 15] = body[at : at + size]
        at += size


def _take_huffman(decoder: _Decoder, body: bytes) -> None:
    at = 0
    while at < len(body):
        counts = body[at + 1 : at + 17]
        end = at + 17 + sum(counts)
        if body[at] >> 4 > 1 or body[at] & 15 > 3 or len(counts) < 16 or end > len(body) or sum(counts) > 256:
            raise FormatError("a broken Huffman table")
        decoder.define((body[at] >> 4, body[at] & 15))
        decoder.tables[body[at] >> 4, body[at] & 15] = counts, body[at + 17 : end]
        at = end


def _take_scan(decoder: _Decoder, data: bytes, body: bytes, start: int) -> int:
    """Write a scan, with the tables that it uses before it; returns the position after its data."""
    from mirror.dataset.images.jpeg_scans import follow_scan

    frame = decoder.frame
    if frame is None:
        raise FormatError("a scan before the frame")
    scan = ScanHeader.parse(body, frame)
    kind = 0 if not frame.progressive else (1 if scan.first == 0 else 3) + (1 if scan.high else 0)
    keys = _used_tables(scan, kind)
    slots = {key: slot for slot, key in enumerate(keys)}
    codes, values = _code_arrays(decoder, keys)
    used = np.zeros((len(keys) or 1, 256), np.uint8)
    blocks, units = _blocks(frame, scan, slots)
    known = _known(scan.components[0][0], units) if kind >= 3 else np.zeros((1, 64), np.uint8)
    raw = np.frombuffer(data, np.uint8)
    most = units // decoder.interval if decoder.interval else 0
    out = np.empty(len(data) - start + 2 * min(most, len(data)) + 8, np.uint8)
    end, length, foreign, filled = follow_scan(
        raw, start, kind, scan.first, scan.last, units, decoder.interval, blocks, codes, values, used, known, out
    )
    if end < 0:
        raise FormatError(f"entropy-coded data that end before the image or are broken, from byte {start} on")
    if foreign:
        decoder.found.add("bytes after the last block of a restart interval")
    if filled:
        decoder.found.add("bits after the last block")
    _write_tables(decoder, scan, keys, used)
    decoder.parts.append(_segment(_SOS, body) + out[:length].tobytes())
    return _skip_foreign(decoder, data, end)


def _used_tables(scan: ScanHeader, kind: int) -> list[tuple[int, int]]:
    keys: list[tuple[int, int]] = []
    for _, dc, ac in scan.components:
        keys += [(0, dc)] if kind in (0, 1) else []
        keys += [(1, ac)] if kind in (0, 3, 4) else []
    return list(dict.fromkeys(keys))


def _blocks(frame: JpegFrame, scan: ScanHeader, slots: Mapping[tuple[int, int], int]) -> tuple[Int64, int]:
    """The tables of the blocks of a unit, and the number of units."""
    single = len(scan.components) == 1
    rows = [
        (slots.get((0, dc), 0), slots.get((1, ac), 0))
        for component, dc, ac in scan.components
        for _ in range(1 if single else component.horizontal * component.vertical)
    ]
    units = frame.blocks_of(scan.components[0][0]) if single else frame.units()
    return np.array(rows, np.int64).reshape(-1, 2), units


def _known(component: Component, units: int) -> UInt8:
    if component.known is None:
        component.known = np.zeros((units, 64), np.uint8)
    return component.known


def _code_arrays(decoder: _Decoder, keys: list[tuple[int, int]]) -> tuple[Int64, UInt8]:
    codes = np.zeros((len(keys) or 1, 3, 17), np.int64)
    values = np.zeros((len(keys) or 1, 256), np.uint8)
    for slot, key in enumerate(keys):
        if key not in decoder.tables:
            raise FormatError("a scan without its Huffman table")
        counts, symbols = decoder.tables[key]
        values[slot, : len(symbols)] = np.frombuffer(symbols, np.uint8)
        code = place = 0
        for length, count in enumerate(counts, 1):
            code *= 2
            codes[slot, :, length] = count, code, place
            code, place = code + count, place + count
            if code > 1 << length:
                raise FormatError("a Huffman table with more codes than bits allow")
    return codes, values


def _write_tables(decoder: _Decoder, scan: ScanHeader, keys: list[tuple[int, int]], used: UInt8) -> None:
    """Write the tables of a scan, and the frame before the first one."""
    fresh = [one for one, _, _ in scan.components if one.identifier not in decoder.latched]
    numbers = sorted({one.quantisation for one in fresh})
    if any(number not in decoder.quantisation for number in numbers):
        raise FormatError("a component without its quantisation table")
    decoder.waiting -= {*keys, *((2, number) for number in numbers)}
    decoder.parts += [_segment(_DQT, decoder.quantisation[number]) for number in numbers]
    if not decoder.latched:
        decoder.parts.append(decoder.frame_segment)
    decoder.latched |= {one.identifier for one in fresh}
    for slot, key in enumerate(keys):
        counts, symbols = decoder.tables[key]
        cleaned = _clean_symbols(key, symbols, used[slot])
        if cleaned != symbols:
            decoder.found.add("codes of a Huffman table that no block uses")
        decoder.parts.append(_segment(_DHT, bytes([16 * key[0] + key[1]]) + counts + cleaned))
    if decoder.interval != decoder.written_interval:
        decoder.parts.append(_segment(_DRI, decoder.interval.to_bytes(2)))
        decoder.written_interval = decoder.interval


def _clean_symbols(key: tuple[int, int], symbols: bytes, used: UInt8) -> bytes:
    """The symbols of a table; those that no block uses are the lowest that are free, in ascending order."""
    if symbols in _standard_symbols(key[0]):
        return symbols
    needed = {symbol for symbol, is_used in zip(symbols, used) if is_used}
    free = iter(sorted(set(range(16 if key[0] == 0 else 256)) - needed))
    return bytes(symbol if is_used else next(free, 0) for symbol, is_used in zip(symbols, used))


def _skip_foreign(decoder: _Decoder, data: bytes, position: int) -> int:
    """The position of the marker after a scan; what lies before it is left out."""
    start = position
    while True:
        position = data.find(b"\xff", position)
        if position < 0 or position + 1 >= len(data):
            raise FormatError("truncated: it has no end marker")
        if data[position + 1] == 0xFF:
            position += 1
        elif data[position + 1] == 0x00 or 0xD0 <= data[position + 1] <= 0xD7:
            position += 2
        else:
            break
    if data[start:position].strip(b"\xff"):
        decoder.found.add("bytes after the last block")
    return position


def _find_end(decoder: _Decoder, data: bytes, position: int) -> int:
    """The position after the end marker; segments and scans before it belong to no image."""
    if data[position : position + 2] == b"\xff\xd9":
        return position + 2
    decoder.found.add("segments after the image")
    return len(data)


def _standard_symbols(kind: int) -> tuple[bytes, ...]:
    """The symbols of the tables K.3 to K.6 of T.81, which encoders write whether or not a block uses each of them."""
    return (_DC_SYMBOLS,) if kind == 0 else (_AC_LUMINANCE, _AC_CHROMINANCE)


_AC_LUMINANCE: Final = bytes.fromhex(
    "01020300041105122131410613516107227114328191a1082342b1c11552d1f02433627282090a161718191a25262728292a34353637"
    "38393a434445464748494a535455565758595a636465666768696a737475767778797a838485868788898a92939495969798999aa2a3"
    "a4a5a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9fa"
)
_AC_CHROMINANCE: Final = bytes.fromhex(
    "000102031104052131061241510761711322328108144291a1b1c109233352f0156272d10a162434e125f11718191a262728292a3536"
    "3738393a434445464748494a535455565758595a636465666768696a737475767778797a82838485868788898a92939495969798999a"
    "a2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae2e3e4e5e6e7e8e9eaf2f3f4f5f6f7f8f9fa"
)
