"""End markers: one rule for reading in, for decoding and for checking."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mirror.dataset.pictures.still import decode_rgb
from mirror.errors import RecordingError
from mirror.recordings.raster import TAIL_BYTES, has_end, require_whole

PIXELS = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)
PICTURES = {"jpeg": cv2.imencode(".jpg", PIXELS)[1].tobytes(), "png": cv2.imencode(".png", PIXELS)[1].tobytes()}
MARKER_BYTES = {"jpeg": 2, "png": 8}


@pytest.mark.parametrize("codec", ["jpeg", "png"])
def test_padding_is_accepted_up_to_the_tail(codec: str) -> None:
    room = TAIL_BYTES - MARKER_BYTES[codec]
    for padding in (0, 1, 2000, room):
        data = PICTURES[codec] + bytes(padding)
        assert has_end(data, codec) and has_end(data[-TAIL_BYTES:], codec)
        require_whole(data, "p")
        assert decode_rgb(data, codec) is not None
    data = PICTURES[codec] + bytes(room + 1)
    assert not has_end(data, codec) and decode_rgb(data, codec) is None
    with pytest.raises(RecordingError, match="no end marker"):
        require_whole(data, "p")


@pytest.mark.parametrize("codec", ["jpeg", "png"])
def test_a_picture_that_is_cut_short_is_refused_by_all(codec: str) -> None:
    data = PICTURES[codec][:-3]
    assert not has_end(data, codec) and decode_rgb(data, codec) is None
    with pytest.raises(RecordingError, match="truncated"):
        require_whole(data, "p")


def test_other_codecs_have_no_marker() -> None:
    assert has_end(b"", "video")
    assert not has_end(b"", "png")
    with pytest.raises(RecordingError, match="neither a JPEG nor a PNG"):
        require_whole(b"", "p")
