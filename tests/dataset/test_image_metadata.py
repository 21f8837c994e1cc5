"""Segments of JPEG files, with fill bytes between the scan and the marker after it."""

from __future__ import annotations

import cv2
import numpy as np

from mirror.dataset.images.metadata import segments, strip_metadata


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
