"""Encoded images with metadata of every kind."""

from __future__ import annotations

import io

import cv2
import numpy as np
from PIL import Image, ImageCms


def pixels(height: int = 96, width: int = 128, seed: int = 0) -> np.ndarray:
    """An image with detail at every scale."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (6, 8, 3)).astype(np.uint8)
    smooth = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC).astype(np.float64)
    return np.clip(smooth + rng.normal(0.0, 4.0, smooth.shape), 0, 255).astype(np.uint8)


def jpeg(
    image: np.ndarray,
    *,
    exif: bool = False,
    gps: bool = False,
    thumbnail: bool = False,
    xmp: bool = False,
    comment: bool = False,
    icc: bool = False,
    orientation: int | None = None,
    tail: bytes = b"",
    **options: object,
) -> bytes:
    """A JPEG with the metadata that is asked for."""
    given: dict[str, object] = {"quality": 88, **options}
    tags = Image.Exif()
    if exif:
        tags[0x010F] = "a maker"
    if gps:
        tags[0x8825] = {1: "N", 2: (49.0, 0.0, 0.0)}
    if orientation is not None:
        tags[0x0112] = orientation
    data = tags.tobytes() if len(tags) else b""
    if thumbnail:
        data = _with_thumbnail(image)
    if data:
        given["exif"] = data
    if xmp:
        given["xmp"] = b"<x:xmpmeta/>"
    if comment:
        given["comment"] = b"somebody was here"
    if icc:
        given["icc_profile"] = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", **given)
    return buffer.getvalue() + tail


def _with_thumbnail(image: np.ndarray) -> bytes:
    """EXIF data (TIFF, little-endian) whose second directory holds a JPEG."""
    buffer = io.BytesIO()
    Image.fromarray(image).resize((16, 12)).save(buffer, "JPEG")
    small = buffer.getvalue()
    header = b"II*\0\x08\0\0\0"
    first = b"\0\0" + (14).to_bytes(4, "little")
    entries = [(0x0201, 14 + 2 + 24 + 4), (0x0202, len(small))]
    second = len(entries).to_bytes(2, "little")
    for tag, value in entries:
        second += tag.to_bytes(2, "little") + (4).to_bytes(2, "little") + (1).to_bytes(4, "little")
        second += value.to_bytes(4, "little")
    return b"Exif\0\0" + header + first + second + b"\0\0\0\0" + small
