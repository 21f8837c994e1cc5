"""Images and videos that a page holds itself."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import TYPE_CHECKING, Final

from mirror.arrays import UInt8
from mirror.pages.rendering import render_part

if TYPE_CHECKING:
    from markupsafe import Markup

_JPEG_QUALITY: Final = 80


def inline_image(image: UInt8, alt: str, width_px: int) -> Markup:
    """Return an ``img`` that holds its image.

    Args:
        image: (H, W, 3), RGB.
        alt: what it shows, in words.
        width_px: wider images are scaled down.
    """
    image = scale_down(image, width_px)
    return render_part("mirror.pages", "parts.html", "image", alt, image.shape[1], image.shape[0], encode_image(image))


def encode_image(image: UInt8) -> str:
    """Encode an image (H, W, 3), RGB, as JPEG in base64."""
    return base64.b64encode(encode_jpeg(image)).decode()


def encode_jpeg(image: UInt8) -> bytes:
    """Encode an image (H, W, 3), RGB, as JPEG in the quality of pages."""
    import cv2

    return cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()


def scale_down(image: UInt8, width_px: int) -> UInt8:
    """Scale an image (H, W, 3) down to a width; a narrower one stays as it is."""
    import cv2
    import numpy as np

    height, width = image.shape[:2]
    if width <= width_px:
        return image
    size = (width_px, round(height * width_px / width))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def inline_video(path: Path) -> Markup:
    """Return a ``video`` that holds an MP4 file."""
    return render_part("mirror.pages", "parts.html", "video", base64.b64encode(path.read_bytes()).decode())
