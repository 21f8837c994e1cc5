"""Glare: light that is brighter than white spreads to neighbouring pixels."""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float32, Float64

QUARTER: Final = 4
"""Glare is computed at a quarter of the resolution."""

_SHARES: Final = (0.05, 0.06, 0.06, 0.05, 0.04)
"""Share of the excess light that each level of a pyramid spreads; each level spreads it twice as far as the one before.
"""
_WHITE: Final = 1.1
_MOST: Final = 12.0


@njit(cache=True, nogil=True, error_model="numpy")
def quarter_excess(image: Float32, gains: Float64, above: float, most: float) -> tuple[Float32, float]:
    """Average the light above a level over blocks of 4 x 4 pixels.

    Args:
        image: (H, W, 3) radiance.
        gains: (3,) exposure gains of the channels.
        above: the level.
        most: upper limit of the excess of a pixel.

    Returns:
        (H / 4, W / 4, 3), rounded up; and the largest excess of a pixel.
    """
    height, width = image.shape[:2]
    small = np.zeros((-(-height // QUARTER), -(-width // QUARTER), 3), np.float32)
    greatest = 0.0
    for i in range(small.shape[0]):
        rows = min(QUARTER, height - QUARTER * i)
        for j in range(small.shape[1]):
            columns = min(QUARTER, width - QUARTER * j)
            red, green, blue = 0.0, 0.0, 0.0
            for row in range(QUARTER * i, QUARTER * i + rows):
                for column in range(QUARTER * j, QUARTER * j + columns):
                    red += min(max(image[row, column, 0] * gains[0] - above, 0.0), most)
                    green += min(max(image[row, column, 1] * gains[1] - above, 0.0), most)
                    blue += min(max(image[row, column, 2] * gains[2] - above, 0.0), most)
            greatest = max(greatest, red + green + blue)
            share = 1.0 / (rows * columns)
            small[i, j, 0], small[i, j, 1], small[i, j, 2] = red * share, green * share, blue * share
    return small, greatest


def glare(image: Float32, gains: Float64) -> Float32 | None:
    """Compute the glare of an image at a quarter of the resolution; None if no pixel is brighter than white.

    Args:
        image: (H, W, 3) radiance.
        gains: (3,) exposure gains of the channels.

    Returns:
        (H / 4, W / 4, 3), rounded up: exposed light to be added.
    """
    import cv2

    surplus, greatest = quarter_excess(image, gains, _WHITE, _MOST)
    if greatest == 0.0:
        return None
    levels = [surplus]
    for _ in _SHARES[1:]:
        levels.append(np.asarray(cv2.pyrDown(levels[-1]), np.float32))
    spilt = np.zeros_like(levels[-1])
    for level, share in zip(reversed(levels), reversed(_SHARES)):
        if spilt.shape != level.shape:
            spilt = np.asarray(cv2.pyrUp(spilt, dstsize=(level.shape[1], level.shape[0])), np.float32)
        spilt = spilt + np.float32(share) * level
    return np.asarray(cv2.GaussianBlur(spilt, (3, 3), 0.8), np.float32)
