"""Small files that claim very large images: the header is read before any pixel, and nothing is allocated."""

from __future__ import annotations

import json
import resource
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mirror.dataset.images.decoding import decode_grey, decode_rgb
from mirror.errors import RecordingError
from mirror.protocols.png import encode_png
from mirror.recordings.raster import MAX_PIXELS, is_decodable
from mirror.recordings.readers.folder import FolderReader
from tests.builders.folder import write_recording

SIDE = 30_000


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@pytest.fixture(scope="module")
def large() -> bytes:
    """A whole grey PNG of 30,000 x 30,000 zeros, in 0.9 MB."""
    packer = zlib.compressobj(1)
    rows = bytes((SIDE + 1) * 100)
    data = b"".join(packer.compress(rows) for _ in range(SIDE // 100)) + packer.flush()
    head = struct.pack(">IIBBBBB", SIDE, SIDE, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def grown_mb(work: Callable[[], object]) -> float:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    work()
    return (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024


def test_large_images_are_not_decoded(large: bytes) -> None:
    assert len(large) < 8 << 20 and SIDE * SIDE > MAX_PIXELS
    assert not is_decodable(large) and not is_decodable(b"") and not is_decodable(b"text")
    assert grown_mb(lambda: (decode_grey(large), decode_rgb(large, "png"))) < 50.0
    assert decode_grey(large) is None and decode_rgb(large, "png") is None
    small = encode_png(np.full((4, 5, 3), 7, np.uint8))
    assert is_decodable(small) and decode_rgb(small, "png") is not None


def test_a_large_mask_of_a_recording_is_an_error(large: bytes, tmp_path: Path) -> None:
    folder = write_recording(tmp_path, "drive")
    document = json.loads((folder / "recording.json").read_text())
    (folder / "large.png").write_bytes(large)
    camera = next(iter(document["cameras"]))
    document["cameras"][camera]["static_mask"] = "large.png"
    (folder / "recording.json").write_text(json.dumps(document))

    def read() -> None:
        with pytest.raises(RecordingError, match="not an image of at most") as caught:
            _ = FolderReader().open(folder, {}).rig
        assert "large.png" in str(caught.value)

    assert grown_mb(read) < 50.0
