"""Masks as PNG files of 0 and 255: a mask tells where something is, and nothing more leaves with it.

A file that is called a mask may hold a photo. Written again from the pixels that are not zero, it holds their outline.
"""

from __future__ import annotations

from pathlib import PurePath

import numpy as np
import numpy.typing as npt

from mirror.errors import DatasetError


def encode_mask(mask: npt.ArrayLike) -> bytes:
    """Encode a mask.

    Args:
        mask: (H, W) pixels.

    Returns:
        A grey PNG: 255 where the mask is not zero, else 0.
    """
    import cv2

    return cv2.imencode(".png", (np.asarray(mask) != 0).astype(np.uint8) * 255)[1].tobytes()


def is_binary(data: bytes) -> bool:
    """Return whether an image is grey with 8 bits, and its pixels are only 0 and 255."""
    pixels = _decode(data)
    return (
        pixels is not None and pixels.ndim == 2 and pixels.dtype == np.uint8 and bool(np.isin(pixels, (0, 255)).all())
    )


def rewrite_mask(data: bytes, file: str | PurePath) -> bytes:
    """Write a mask again as a PNG of 0 and 255.

    Args:
        data: a mask; pixels that are not zero in some channel belong to it.
        file: for messages.

    Raises:
        DatasetError: it cannot be decoded.
    """
    pixels = _decode(data)
    if pixels is None:
        raise DatasetError("the mask cannot be decoded", file=file, expected="a PNG", remedy="restore the file")
    return encode_mask(pixels if pixels.ndim == 2 else (pixels[..., :3] != 0).any(axis=2))


def _decode(data: bytes) -> npt.NDArray[np.generic] | None:
    import cv2

    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
