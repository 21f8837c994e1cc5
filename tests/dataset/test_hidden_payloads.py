"""A thumbnail hidden anywhere in an image file is named and removed; the pixels of real encoders stay the same."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from mirror.dataset.images.metadata import list_metadata, segments, strip_metadata
from mirror.errors import DatasetError
from tests.privacy.images import pixels

SIZE = (61, 85)
IMAGE = pixels(*SIZE, seed=3)


def pillow(image: Image.Image, kind: str = "JPEG", **options: object) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


THUMBNAIL = pillow(Image.fromarray(pixels(24, 24, seed=9)), quality=60)
HIDDEN = next(THUMBNAIL[one.start + 14 : one.end] for one in segments(THUMBNAIL, "") if one.marker == 0xDA)
PLAIN = cv2.imencode(".jpg", IMAGE)[1].tobytes()


def decoded(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """The pixels as two independent decoders see them."""
    image = Image.open(io.BytesIO(data))
    return np.asarray(image.convert("RGBA")), cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)


def require_same_pixels(one: bytes, other: bytes) -> None:
    for mine, theirs in zip(decoded(one), decoded(other)):
        assert np.array_equal(mine, theirs)


def require_gone(data: bytes, name: str, cover: bytes | None = None) -> bytes:
    """The image without what is hidden in it: no part of the thumbnail is left, and the pixels are those of the cover.

    Not every decoder reads an image with the thumbnail, so the image before is compared, where there is one.
    """
    assert list_metadata(data, name)
    stripped = strip_metadata(data, name)
    require_same_pixels(stripped, data if cover is None else cover)
    assert list_metadata(stripped, name) == []
    # Its scan: its tables are those of other images too.
    assert not any(HIDDEN[at : at + 10] in stripped for at in range(len(HIDDEN) - 10))
    return stripped


REAL = {
    **{
        f"pillow {quality} {subsampling} {progressive} {optimize} {interval}": pillow(
            Image.fromarray(IMAGE),
            quality=quality,
            subsampling=subsampling,
            progressive=progressive,
            optimize=optimize,
            restart_marker_blocks=interval,
        )
        for quality, subsampling, progressive, optimize, interval in product(
            (20, 90), (0, 1, 2), (False, True), (False, True), (0, 1, 5)
        )
    },
    "best": pillow(Image.fromarray(IMAGE), quality=100),
    "flat": pillow(Image.new("RGB", (33, 17), (9, 9, 9)), progressive=True),
    "one pixel": pillow(Image.new("RGB", (1, 1))),
    "grey": pillow(Image.fromarray(IMAGE).convert("L"), restart_marker_rows=1),
    "grey progressive": pillow(Image.fromarray(IMAGE).convert("L"), progressive=True),
    "inks": pillow(Image.fromarray(IMAGE).convert("CMYK")),
    "inks progressive": pillow(Image.fromarray(IMAGE).convert("CMYK"), progressive=True),
    **{
        f"opencv {'/'.join(map(str, options))}": cv2.imencode(".jpg", IMAGE, list(options))[1].tobytes()
        for options in (
            (),
            (cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
            (cv2.IMWRITE_JPEG_RST_INTERVAL, 2),
            (cv2.IMWRITE_JPEG_OPTIMIZE, 1, cv2.IMWRITE_JPEG_QUALITY, 98),
            (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_440),
            (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_411),
        )
    },
}


def test_images_of_real_encoders_keep_their_pixels_and_hold_nothing_else() -> None:
    for name, data in REAL.items():
        assert list_metadata(data, name) == [], name
        stripped = strip_metadata(data, name)
        require_same_pixels(stripped, data)
        assert strip_metadata(stripped, name) == stripped
        scans = [[one[s.start : s.end] for s in segments(one, name) if s.marker == 0xDA] for one in (data, stripped)]
        assert scans[0] == scans[1], name


def segment(marker: int, body: bytes) -> bytes:
    return bytes((0xFF, marker)) + (len(body) + 2).to_bytes(2) + body


def stuffed(data: bytes) -> bytes:
    return data.replace(b"\xff", b"\xff\0")


def before_scan(data: bytes, part: bytes) -> bytes:
    at = next(one.start for one in segments(data, "") if one.marker == 0xDA)
    return data[:at] + part + data[at:]


def before_end(data: bytes, part: bytes) -> bytes:
    return data[:-2] + part + data[-2:]


def in_restart(data: bytes, number: int, part: bytes) -> bytes:
    at = data.index(bytes((0xFF, 0xD0 + number)))
    return data[:at] + part + data[at:]


def huffman_table(number: int, kind: int, payload: bytes) -> bytes:
    """A table with as many codes as it has symbols: 16 bits each."""
    return bytes([16 * kind + number]) + bytes(15) + bytes([len(payload)]) + payload


RESTARTING = REAL["pillow 90 0 False False 5"]
PROGRESSIVE = REAL["pillow 90 2 True True 0"]
SCAN = next(PLAIN[one.start : one.end] for one in segments(PLAIN, "") if one.marker == 0xDA)
JPEGS = {
    "DNL": before_end(PLAIN, segment(0xDC, THUMBNAIL)),
    "DNL before the scan": before_scan(PLAIN, segment(0xDC, THUMBNAIL)),
    "after the last block": before_end(PLAIN, stuffed(THUMBNAIL)),
    "after the last block of a progressive scan": before_end(PROGRESSIVE, stuffed(THUMBNAIL)),
    "between scans": before_scan(PROGRESSIVE, segment(0xE7, THUMBNAIL)),
    "before a restart marker": in_restart(RESTARTING, 3, stuffed(THUMBNAIL)),
    "restart markers after the end": before_end(PLAIN, b"\xff\xd0" + stuffed(THUMBNAIL) + b"\xff\xd1"),
    "a scan after the image": before_end(PLAIN, SCAN[:14] + stuffed(THUMBNAIL)),
    "a second image": PLAIN + THUMBNAIL,
    "an image in an image": before_end(PLAIN, segment(0xFE, THUMBNAIL)),
    "a Huffman table that no scan uses": before_scan(PLAIN, segment(0xC4, huffman_table(3, 1, THUMBNAIL[-255:]))),
    "a Huffman table after the image": before_end(PLAIN, segment(0xC4, huffman_table(1, 1, THUMBNAIL[-255:]))),
    "a quantisation table that no component uses": before_scan(PLAIN, segment(0xDB, b"\3" + THUMBNAIL[-64:])),
    "quantisation tables that are replaced": before_scan(
        PLAIN, b"".join(segment(0xDB, b"\2" + THUMBNAIL[at : at + 64]) for at in range(0, len(THUMBNAIL) - 64, 64))
    ),
    "JFIF": PLAIN[:2] + segment(0xE0, b"JFIF\0\1\1\0\0\1\0\1\x10\x10" + THUMBNAIL[:768]) + PLAIN[20:],
    "Adobe": before_scan(REAL["inks"], segment(0xEE, b"Adobe\0\x64\0\0\0\0\0" + THUMBNAIL)),
    **{
        f"marker FF{marker:02X}": before_scan(PLAIN, segment(marker, THUMBNAIL))
        for marker in (*range(0x02, 0xC0, 17), 0xDC, *range(0xDE, 0xF0), *range(0xF0, 0xFF), 0xC8, 0xCC)
    },
}  # fmt: skip


@pytest.mark.parametrize("place", JPEGS)
def test_a_thumbnail_in_a_jpeg_is_found_and_removed(place: str) -> None:
    covers = {"Adobe": REAL["inks"], "before a restart marker": RESTARTING}
    cover = PROGRESSIVE if place in ("after the last block of a progressive scan", "between scans") else PLAIN
    require_gone(JPEGS[place], "a.jpg", covers.get(place, cover))


def test_bits_that_fill_up_bytes_hold_nothing() -> None:
    """With a restart marker after each block, the bits before it could hold a thumbnail."""
    data = bytearray(REAL["pillow 20 0 False False 1"])
    plain = bytes(data)
    ends = [at for at in range(len(data) - 1) if data[at] == 0xFF and 0xD0 <= data[at + 1] <= 0xD7]
    for at in ends:
        # The lowest bit is 1 in every interval that does not end with its byte.
        if data[at - 1] not in (0, 0xFE):
            data[at - 1] &= 0xFE
    assert bytes(data) != plain
    assert strip_metadata(bytes(data), "a.jpg") == strip_metadata(plain, "a.jpg")


def test_codes_that_no_block_uses_hold_nothing() -> None:
    flat = cv2.imencode(".jpg", np.full((16, 16, 3), 77, np.uint8))[1].tobytes()
    data = bytearray(flat)
    tables = [one for one in segments(flat, "") if one.marker == 0xC4]
    last = tables[-1]
    # No longer a table of the standard: the symbols of its longest codes, which the image does not use, are free.
    data[last.end - 100 : last.end] = THUMBNAIL[-100:]
    stripped = strip_metadata(bytes(data), "a.jpg")
    assert "codes of a Huffman table that no block uses" in list_metadata(bytes(data), "a.jpg")
    assert THUMBNAIL[-40:] not in stripped and list_metadata(stripped, "a.jpg") == []
    require_same_pixels(stripped, flat)


def test_a_smaller_frame_leaves_no_rows_behind() -> None:
    frame = next(one for one in segments(PLAIN, "") if one.marker == 0xC0)
    data = PLAIN[: frame.start + 5] + (16).to_bytes(2) + PLAIN[frame.start + 7 :]
    stripped = require_gone(data, "a.jpg")
    assert decoded(stripped)[1].shape[:2] == (16, SIZE[1]) and len(stripped) < 0.7 * len(PLAIN)


@pytest.mark.parametrize("marker", [0xC3, 0xC5, 0xC9, 0xCA])
def test_frames_that_no_camera_writes_are_refused(marker: int) -> None:
    data = PLAIN.replace(b"\xff\xc0", bytes((0xFF, marker)), 1)
    with pytest.raises(DatasetError, match=r"a\.jpg.*which no camera writes"):
        strip_metadata(data, "a.jpg")


def png_chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png_of(*chunks: tuple[bytes, bytes]) -> bytes:
    return b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*one) for one in chunks)


def header(width: int, height: int, depth: int, colour: int) -> tuple[bytes, bytes]:
    return b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)


ROWS = b"".join(b"\0" + row.tobytes() for row in IMAGE)
COLOURED = header(SIZE[1], SIZE[0], 8, 2)
BODY = (b"IDAT", zlib.compress(ROWS))
END = (b"IEND", b"")
INDICES = np.random.default_rng(0).integers(0, 4, (16, 16)).astype(np.uint8)
INDEXED = (b"IDAT", zlib.compress(b"".join(b"\0" + row.tobytes() for row in INDICES)))
COLOURS = bytes(range(10, 22))
HIDDEN_COLOURS = THUMBNAIL[-252:]
ONE_BIT = np.packbits(np.random.default_rng(1).integers(0, 2, (40, 9)).astype(np.uint8), axis=1)
ONE_BIT[:, 1] |= np.frombuffer(THUMBNAIL, np.uint8)[:40] & 0x7F
PNGS = {
    "a further chunk of data": png_of(COLOURED, BODY, (b"IDAT", THUMBNAIL), END),
    "a chunk of data after another": png_of(COLOURED, BODY, (b"tEXt", b"a\0b"), (b"IDAT", THUMBNAIL), END),
    "after the compressed data": png_of(COLOURED, (b"IDAT", BODY[1] + THUMBNAIL), END),
    "rows after the last": png_of(COLOURED, (b"IDAT", zlib.compress(ROWS + THUMBNAIL, 0)), END),
    "a palette of a coloured image": png_of(COLOURED, (b"PLTE", THUMBNAIL[:768]), BODY, END),
    "colours that no pixel has": png_of(
        header(16, 16, 8, 3), (b"PLTE", COLOURS + HIDDEN_COLOURS), INDEXED, END
    ),
    "transparency that no pixel has": png_of(
        header(16, 16, 8, 3), (b"PLTE", COLOURS + bytes(252)), (b"tRNS", b"\xff" * 4 + THUMBNAIL[-80:]), INDEXED, END
    ),
    "transparency of a wrong length": png_of(COLOURED, (b"tRNS", bytes(6) + THUMBNAIL), BODY, END),
    "a second palette": png_of(
        header(16, 16, 8, 3), (b"PLTE", COLOURS), INDEXED, (b"PLTE", THUMBNAIL[:768]), END
    ),
    "after the end": png_of(COLOURED, BODY, END) + THUMBNAIL,
    "in the end": png_of(COLOURED, BODY, (b"IEND", THUMBNAIL)),
    "bits of rows": png_of(
        header(9, 40, 1, 0), (b"IDAT", zlib.compress(b"".join(b"\0" + row.tobytes() for row in ONE_BIT))), END
    ),
    **{
        kind: png_of(COLOURED, (kind.encode(), THUMBNAIL), BODY, END)
        for kind in ("tEXt", "eXIf", "iCCP", "abCd", "fdAT")
    },
}  # fmt: skip


@pytest.mark.parametrize("place", PNGS)
def test_a_thumbnail_in_a_png_is_found_and_removed(place: str) -> None:
    cover = PNGS[place]
    if place in ("iCCP", "fdAT"):
        cover = png_of(COLOURED, BODY, END)
    if place == "a second palette":
        cover = png_of(header(16, 16, 8, 3), (b"PLTE", COLOURS), INDEXED, END)
    stripped = require_gone(PNGS[place], "a.png", cover)
    # Not compressed again either.
    assert len(stripped) <= len(strip_metadata(png_of(COLOURED, BODY, END), "a.png"))


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA", "I;16"])
def test_pngs_of_real_encoders_keep_their_pixels(mode: str) -> None:
    coloured = Image.fromarray(IMAGE)
    image = Image.fromarray(IMAGE[..., 0].astype(np.uint16) * 257) if mode == "I;16" else coloured.convert(mode)
    options: list[dict[str, object]] = [{}, {"optimize": True}]
    if mode == "P":
        image = coloured.quantize(200)
        options += [{"transparency": 3}, {"bits": 8}]
        options += [{"transparency": bytes(range(56, 256))}]
    for given in options:
        data = pillow(image, "PNG", **given)
        stripped = strip_metadata(data, "a.png")
        mine, theirs = (Image.open(io.BytesIO(one)) for one in (stripped, data))
        assert mine.mode == theirs.mode and np.array_equal(np.asarray(mine), np.asarray(theirs))
        require_same_pixels(stripped, data)
        assert strip_metadata(stripped, "a.png") == stripped and list_metadata(stripped, "a.png") == []
    for count in (2, 3, 16):
        data = pillow(coloured.quantize(count), "PNG")
        assert np.array_equal(decoded(strip_metadata(data, "a.png"))[0], decoded(data)[0])


def test_an_interlaced_png_keeps_its_pixels() -> None:
    depths = ((8, 2), (4, 3), (1, 0), (16, 4))
    rng = np.random.default_rng(5)
    for (depth, colour), (width, height) in product(depths, ((1, 1), (5, 3), (19, 23))):
        channels = {0: 1, 2: 3, 3: 1, 4: 2}[colour]
        raw = b""
        for left, top, step, down in (
            (0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2),
        ):  # fmt: skip
            wide, high = -(-(width - left) // step), -(-(height - top) // down)
            if wide > 0 and high > 0:
                size = -(-wide * depth * channels // 8)
                raw += b"".join(bytes([rng.integers(0, 5)]) + rng.bytes(size) for _ in range(high))
        palette = [(b"PLTE", rng.bytes(48))] if colour == 3 else []
        head = b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 1)
        data = png_of(head, *palette, (b"IDAT", zlib.compress(raw)), END)
        stripped = strip_metadata(data, "a.png")
        assert np.array_equal(decoded(stripped)[0], decoded(data)[0])


@pytest.mark.parametrize("data", [PLAIN, PROGRESSIVE, RESTARTING, PNGS["colours that no pixel has"]])
def test_damaged_bytes_end_with_an_error_that_names_the_file(data: bytes) -> None:
    rng = np.random.default_rng(0)
    function: Callable[[bytes, Path], object]
    for number in range(250):
        broken = bytearray(data)
        for at in rng.integers(2, len(data), 1 + number % 4):
            broken[at] = rng.integers(0, 256)
        cut = bytes(broken[: rng.integers(3, len(data))]) if number % 5 == 0 else bytes(broken)
        for function in (strip_metadata, list_metadata):
            try:
                function(cut, Path("broken.jpg"))
            except DatasetError as error:
                assert "broken.jpg" in str(error)


@pytest.mark.parametrize("cut", [1, 20, 255])
def test_a_huffman_table_that_is_cut_off_is_refused(cut: int) -> None:
    """Its counts promise more symbols than its segment has."""
    table = huffman_table(3, 1, THUMBNAIL[-255:])
    for function in (strip_metadata, list_metadata):
        with pytest.raises(DatasetError, match="a broken Huffman table"):
            function(before_scan(PLAIN, segment(0xC4, table[:-cut])), "a.jpg")


@pytest.mark.parametrize("length", range(8))
@pytest.mark.parametrize(("colour", "channels", "right"), [(0, 1, 2), (2, 3, 6), (4, 2, None), (6, 4, None)])
def test_a_transparent_colour_has_the_length_of_its_format(
    colour: int, channels: int, right: int | None, length: int
) -> None:
    """An image with an alpha channel has no transparent colour, whose bytes would hold something else."""
    head = b"IHDR", struct.pack(">IIBBBBB", 3, 2, 8, colour, 0, 0, 0)
    rows = (b"IDAT", zlib.compress(b"".join(b"\0" + bytes(range(9, 9 + 3 * channels)) for _ in range(2))))
    data = png_of(head, (b"tRNS", b"\7" * length), rows, END)
    is_kept = length == right
    assert ("a transparency of a wrong length" in list_metadata(data, "a.png")) == (length > 0 and not is_kept)
    assert (b"tRNS" in strip_metadata(data, "a.png")) == is_kept
