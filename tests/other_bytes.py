"""Images that get other bytes under their names, as when a recording was exported again."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from mirror.dataset.image import Image
from tests.calibration.corridor import padded


def give_other_bytes(root: Path, image: Image, value: int = 7) -> None:
    """Replace a recorded image of a dataset by a flat one with the same name, size and length."""
    flat = np.full((image.height_px, image.width_px, 3), value, np.uint8)
    if image.codec == "png":
        data = padded(cv2.imencode(".png", flat)[1].tobytes(), image.byte_length)
    else:
        data = _commented(cv2.imencode(".jpg", flat)[1].tobytes(), image.byte_length)
    path = root / image.uri
    path.unlink()
    path.write_bytes(data)


def _commented(jpeg: bytes, length: int) -> bytes:
    """A JPEG with a comment, so that it has a length."""
    size = length - len(jpeg) - 2
    assert 2 <= size < 65536
    return jpeg[:2] + b"\xff\xfe" + size.to_bytes(2) + bytes(size - 2) + jpeg[2:]
