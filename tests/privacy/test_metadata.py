"""Metadata of encoded images: it is named, and its removal leaves the encoded pixels as they are."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, PngImagePlugin

from mirror.dataset.images.decoding import decode_rgb
from mirror.dataset.images.metadata import list_metadata, read_orientation, segments, strip_metadata
from mirror.errors import DatasetError
from tests.privacy.images import jpeg, pixels

PLANTED = {
    "EXIF": {"exif": True},
    "GPS": {"gps": True},
    "thumbnail": {"thumbnail": True},
    "XMP": {"xmp": True},
    "comment": {"comment": True},
    "ICC profile": {"icc": True},
    "bytes after the end": {"tail": b"\0\0hidden"},
}


def scan(data: bytes) -> bytes:
    return b"".join(data[one.start : one.end] for one in segments(data, "") if one.marker == 0xDA)


@pytest.mark.parametrize("name", PLANTED)
def test_each_kind_of_metadata_is_named_and_removed(name: str) -> None:
    plain, data = jpeg(pixels()), jpeg(pixels(), **PLANTED[name])
    assert name in list_metadata(data, "x.jpg")
    stripped = strip_metadata(data, "x.jpg")
    assert list_metadata(stripped, "x.jpg") == []
    assert scan(stripped) == scan(data) == scan(plain)
    assert np.array_equal(decode_rgb(stripped, "jpeg"), decode_rgb(data, "jpeg"))
    assert strip_metadata(stripped, "x.jpg") == stripped


@pytest.mark.parametrize("options", [{"progressive": True}, {"subsampling": 2}, {"restart_marker_blocks": 1}])
def test_progressive_and_restarting_files_keep_their_scans(options: dict[str, object]) -> None:
    data = jpeg(pixels(), exif=True, **options)
    stripped = strip_metadata(data, "x.jpg")
    assert scan(stripped) == scan(data)
    assert np.array_equal(decode_rgb(stripped, "jpeg"), decode_rgb(data, "jpeg"))


def test_the_colour_transform_of_an_adobe_segment_is_kept() -> None:
    image = Image.fromarray(pixels()).convert("CMYK")
    buffer = io.BytesIO()
    image.save(buffer, "JPEG")
    stripped = strip_metadata(buffer.getvalue(), "x.jpg")
    assert b"Adobe" in stripped
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(stripped))), np.asarray(Image.open(buffer)))


def test_text_chunks_of_a_png_are_removed() -> None:
    text = PngImagePlugin.PngInfo()
    text.add_text("Author", "somebody")
    buffer = io.BytesIO()
    Image.fromarray(pixels()).save(buffer, "PNG", pnginfo=text)
    data = buffer.getvalue() + b"tail"
    assert list_metadata(data, "x.png") == ["PNG chunk tEXt", "bytes after the end"]
    stripped = strip_metadata(data, "x.png")
    assert list_metadata(stripped, "x.png") == []
    assert np.array_equal(decode_rgb(stripped, "png"), pixels())


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_read(orientation: int) -> None:
    assert read_orientation(jpeg(pixels(), orientation=orientation)) == orientation


@pytest.mark.parametrize("data", [b"", b"\xff\xd8", b"GIF89a", b"\x89PNG\r\n\x1a\n\0\0", jpeg(pixels())[:-40]])
def test_broken_images_are_errors_that_name_the_file(data: bytes) -> None:
    for function in (list_metadata, strip_metadata):
        with pytest.raises(DatasetError, match=r"broken\.jpg"):
            function(data, Path("broken.jpg"))
    assert read_orientation(data) == 1
