"""Segments of JPEG files, with fill bytes between the scan and the marker after it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mirror.dataset.images.metadata import list_metadata, segments, strip_metadata
from tests.privacy.images import jpeg, pixels


def test_fill_bytes_after_a_scan() -> None:
    image = np.random.default_rng(0).integers(0, 256, (16, 24, 3), dtype=np.uint8)
    data = cv2.imencode(".jpg", image)[1].tobytes()
    assert data[-2:] == b"\xff\xd9"
    filled = data[:-2] + b"\xff\xff" + data[-2:]
    plain, padded = list(segments(data, "a.jpg")), list(segments(filled, "a.jpg"))
    assert [one.marker for one in padded] == [one.marker for one in plain]
    stripped = strip_metadata(filled, "a.jpg")
    np.testing.assert_array_equal(
        cv2.imdecode(np.frombuffer(stripped, np.uint8), cv2.IMREAD_COLOR),
        cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR),
    )


def test_segments_after_a_marker_without_length() -> None:
    data = cv2.imencode(".jpg", np.full((16, 24, 3), 90, np.uint8))[1].tobytes()
    comment = b"\xff\xfe" + (2 + 5).to_bytes(2, "big") + b"words"
    marked = data[:2] + b"\xff\x01" + comment + data[2:]
    assert [one.marker for one in segments(marked, "a.jpg")][:2] == [0x01, 0xFE]
    assert list_metadata(marked, "a.jpg") == list_metadata(data[:2] + comment + data[2:], "a.jpg")
    assert list_metadata(data, "a.jpg") != list_metadata(marked, "a.jpg")


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ((), []),
        (("exif",), ["EXIF"]),
        (("gps",), ["EXIF", "GPS"]),
        (("thumbnail",), ["EXIF", "thumbnail"]),
        (("xmp",), ["XMP"]),
        (("icc",), ["ICC profile"]),
        (("comment",), ["comment"]),
    ],
)
def test_what_an_encoder_wrote_is_listed(given: tuple[str, ...], found: list[str]) -> None:
    data = jpeg(pixels(16, 24), **dict.fromkeys(given, True))
    assert list_metadata(data, "a.jpg") == found
