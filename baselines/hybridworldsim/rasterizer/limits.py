"""The limits of images and scenes: sizes that would overflow an index, or fit into no memory, are refused."""

from __future__ import annotations

import operator
from typing import Final

import numpy as np

from mirror.errors import UsageError

SIDE_MAX: Final = 65535 * 16
"""Greatest side of an image, pixels: columns and rows of tiles are numbered in 16 bits."""

PIXELS_MAX: Final = 2**28
"""Greatest number of pixels of an image: rendering takes 55 bytes per pixel, 115 with gradients (29 GiB)."""

GAUSSIANS_MAX: Final = 2**31 - 1
"""Greatest number of Gaussians of a scene: their order is int32."""

PAIRS_MAX: Final = 2**31 - 1
"""Greatest number of pairs of tile and Gaussian in one list: their indices are int32; each takes 12 bytes."""


def require_positive(place: str, value: int) -> int:
    """Check that a value is an integer of at least 1.

    Raises:
        UsageError: it is not.
    """
    try:
        number = 0 if isinstance(value, bool | np.bool_) else operator.index(value)
    except TypeError:
        number = 0
    if number < 1:
        raise UsageError(f"{value!r} is no size", place=place, expected="a whole number of at least 1")
    return number


def check_image_size(width: int, height: int) -> tuple[int, int]:
    """Check the width and height of an image, pixels.

    Raises:
        UsageError: one is no positive integer, or the image is too large.
    """
    width, height = require_positive("width", width), require_positive("height", height)
    remedy = "render the image in parts: for the part whose corner is (x, y), subtract x and y from cx and cy of Ks"
    for place, side in (("width", width), ("height", height)):
        if side > SIDE_MAX:
            raise UsageError(f"{side} pixels", place=place, expected=f"at most {SIDE_MAX}", remedy=remedy)
    if width * height > PIXELS_MAX:
        raise UsageError(
            f"an image of {width} x {height} pixels, which is {width * height}",
            place="width, height",
            expected=f"at most {PIXELS_MAX} pixels",
            remedy=remedy,
        )
    return width, height


def refuse_too_many(gaussians: int) -> None:
    """Refuse scenes with more Gaussians than an index can number.

    Raises:
        UsageError: there are more than `GAUSSIANS_MAX`.
    """
    if gaussians > GAUSSIANS_MAX:
        raise UsageError(
            f"{gaussians} Gaussians",
            place="means",
            expected=f"at most {GAUSSIANS_MAX}",
            remedy="render blocks of the scene that the camera reaches",
        )


def refuse_too_many_pairs(pairs: int) -> None:
    """Refuse lists of pairs that are longer than an index can number.

    Raises:
        UsageError: there are more than `PAIRS_MAX`.
    """
    if pairs > PAIRS_MAX:
        raise UsageError(
            f"{pairs} pairs of a tile of 16 x 16 pixels and a Gaussian that may reach it",
            place="scales, width, height",
            expected=f"at most {PAIRS_MAX} in a part of the scene",
            remedy="render a smaller image, or the image in parts, or smaller Gaussians",
        )
