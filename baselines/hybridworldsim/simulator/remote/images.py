"""Images as bytes: PNG and JPEG."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np

from mirror.arrays import UInt8
from mirror.errors import MirrorError

Format = Literal["jpeg", "png"]


def encode(rgb: UInt8, image_format: Format, quality: int) -> bytes:
    """Encode an image (H, W, 3).

    Raises:
        MirrorError: the image cannot be encoded.
    """
    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if image_format == "jpeg" else [cv2.IMWRITE_PNG_COMPRESSION, 1]
    done, data = cv2.imencode(".jpg" if image_format == "jpeg" else ".png", rgb[..., ::-1], options)
    if not done:
        raise MirrorError(f"an image of shape {rgb.shape} cannot be encoded as {image_format}")
    return np.asarray(data).tobytes()
