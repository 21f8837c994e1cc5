"""Untrusted PNGs: complete plain ones pass, problems are named, and nothing is decoded before these checks."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.protocols.png import (
    RenderError,
    decode_render,
    encode_png,
    find_png_problem,
    max_png_bytes,
    png_size,
)
from tests.draws import draws
from tests.evaluation.png_chunks import chunk, png

PIXELS = np.random.default_rng(0).integers(0, 256, (9, 16, 3), np.uint8)
WHOLE = encode_png(PIXELS)


IDAT = chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row.tobytes() for row in PIXELS)))


def test_plain_png_is_decoded_exactly() -> None:
    assert find_png_problem(WHOLE) is None
    assert png_size(WHOLE) == (16, 9)
    np.testing.assert_array_equal(decode_render(WHOLE, 16, 9, "a.png"), PIXELS)
    assert find_png_problem(png(chunk(b"sRGB", b"\0"), chunk(b"gAMA", struct.pack(">I", 45455)), IDAT)) is None


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "not a PNG"),
        (b"\xff\xd8\xff\xe0 a JPEG", "not a PNG"),
        (b"\x80\x04\x95 a pickle", "not a PNG"),
        (WHOLE[:20], "cut off in its header"),
        (WHOLE + b"PK\x03\x04", "after its end"),
        (png(IDAT, depth=16), "16 bit RGB"),
        (png(IDAT, colour=6), "RGB with alpha"),
        (png(IDAT, colour=0), "grey"),
        (png(IDAT, colour=3), "palette"),
        (png(IDAT, interlaced=1), "interlaced"),
        (png(chunk(b"iCCP", b"x\0\0" + zlib.compress(b"0" * 100)), IDAT), "iCCP"),
        (png(chunk(b"zTXt", b"x\0\0" + zlib.compress(b"0" * 10**6)), IDAT), "zTXt"),
        (png(chunk(b"acTL", bytes(8)), IDAT), "acTL"),
        (png(chunk(b"gAMA", struct.pack(">I", 100000)), IDAT), "gamma"),
        (png(), "without pixels"),
    ],
)
def test_broken_png_is_named(data: bytes, words: str) -> None:
    assert words in str(find_png_problem(data))
    with pytest.raises(RenderError):
        decode_render(data, 16, 9, "a.png")


@pytest.mark.parametrize("length", range(0, len(WHOLE), 7))
def test_truncated_png_is_refused(length: int) -> None:
    assert find_png_problem(WHOLE[:length]) is not None


@given(st.integers(0, len(WHOLE) - 1), st.integers(1, 255))
@settings(max_examples=draws(200))
def test_changed_byte_is_detected(place: int, change: int) -> None:
    changed = bytearray(WHOLE)
    changed[place] ^= change
    assert find_png_problem(bytes(changed)) is not None


def test_oversized_png_is_refused_by_its_header() -> None:
    bomb = png(chunk(b"IDAT", zlib.compress(bytes(1000))), width=1 << 30, height=1 << 30)
    assert png_size(bomb) == (1 << 30, 1 << 30)
    with pytest.raises(RenderError, match="size"):
        decode_render(bomb, 16, 9, "bomb.png")
    # Pixels beyond the size in the header are not read.
    long = png(chunk(b"IDAT", zlib.compress(bytes(10**7))))
    pixels = decode_render(long, 16, 9, "long.png")
    assert pixels.shape == (9, 16, 3)
    # Too few pixels are an error.
    with pytest.raises(RenderError, match="decoded"):
        decode_render(png(chunk(b"IDAT", b"\x00\x01\x02\x03")), 16, 9, "garbage.png")


@pytest.mark.parametrize(("width", "height"), [(1, 1), (960, 540), (33, 1000)])
def test_valid_png_is_within_the_size_limit(width: int, height: int) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (height, width, 3), np.uint8)
    stored = cv2.imencode(".png", noise, [cv2.IMWRITE_PNG_COMPRESSION, 0])[1]
    assert len(stored) < max_png_bytes(width, height)
