"""Compiled even-odd filling."""

from __future__ import annotations

import math

from numba import njit

from mirror.arrays import Bool, Float64
from mirror.compiled import inner_njit


@njit(cache=True, nogil=True)
def fill(mask: Bool, polygon: Float64) -> None:
    """Set the pixels (H, W), all unset so far, whose centres a polygon (K, 2) of finite corners holds."""
    height, width = mask.shape
    top, bottom, left, right = height, 0, width, 0
    for index in range(len(polygon)):
        upper, lower = polygon[index - 1], polygon[index]
        # Every side from its upper end to its lower one, so that two polygons compute one crossing of a shared side.
        if upper[1] > lower[1]:
            upper, lower = lower, upper
        first, last = _whole(upper[1], height), _whole(lower[1], height)
        for row in range(first, last):
            share = (row + 0.5 - upper[1]) / (lower[1] - upper[1])
            column = _whole(upper[0] + share * (lower[0] - upper[0]), width)
            # The quotient is rounded; these products are exact for corners of few digits, such as whole pixels.
            while column > 0 and _right_of(column - 0.5, row + 0.5, upper, lower):
                column -= 1
            while column < width and not _right_of(column + 0.5, row + 0.5, upper, lower):
                column += 1
            left, right = min(left, column), max(right, column)
            if column < width:
                mask[row, column] ^= True
        if first < last:
            top, bottom = min(top, first), max(bottom, last)
    # Each crossing turns the rest of its row over.
    for row in range(top, bottom):
        inside = False
        for column in range(left, min(right + 1, width)):
            inside ^= mask[row, column]
            mask[row, column] = inside


@inner_njit
def _whole(coordinate: float, size: int) -> int:
    """The first pixel whose centre is not below a coordinate, or one beyond the last."""
    return math.ceil(min(max(coordinate - 0.5, 0.0), float(size)))


@inner_njit
def _right_of(x: float, y: float, upper: Float64, lower: Float64) -> bool:
    """Return whether a point lies on a side that goes down, or to the right of it."""
    return (x - upper[0]) * (lower[1] - upper[1]) >= (y - upper[1]) * (lower[0] - upper[0])
