"""Tests whether road users overlap."""

from __future__ import annotations

import numpy as np
from numba import njit

from mirror.arrays import Bool, Float64
from mirror.portable import scalars


@njit(cache=True, nogil=True)
def select_non_overlapping(places: Float64, halves: Float64, fixed: Bool, within_m: float) -> Bool:
    """Select road users in order, each only if it overlaps no road user selected before.

    Args:
        places: (N, T, 3) x, y and yaw of the middle of each user at each time; NaN while it is absent.
        halves: (N, 2) half lengths and half widths, metres.
        fixed: (N,) users that are selected in any case.
        within_m: distance from the origin within which overlaps count.

    Returns:
        (N,) True for the selected users.
    """
    count, times = places.shape[:2]
    is_selected = np.ones(count, np.bool_)
    for i in range(count):
        if fixed[i]:
            continue
        for j in range(count):
            if (j >= i and not fixed[j]) or j == i or not is_selected[j]:
                continue
            reach = scalars.hypot(halves[i, 0], halves[i, 1]) + scalars.hypot(halves[j, 0], halves[j, 1])
            for t in range(times):
                dx, dy = places[j, t, 0] - places[i, t, 0], places[j, t, 1] - places[i, t, 1]
                if not dx * dx + dy * dy < reach * reach:
                    continue
                if scalars.hypot(places[i, t, 0], places[i, t, 1]) > within_m:
                    continue
                if _overlap(dx, dy, places[i, t, 2], places[j, t, 2], halves[i], halves[j]):
                    is_selected[i] = False
                    break
            if not is_selected[i]:
                break
    return is_selected


@njit(cache=True, nogil=True)
def _overlap(dx: float, dy: float, yaw: float, other: float, half: Float64, half_other: Float64) -> bool:
    """Return whether two rectangles overlap: no side of either separates them."""
    cos, sin = scalars.cos(yaw), scalars.sin(yaw)
    cos_other, sin_other = scalars.cos(other), scalars.sin(other)
    c, s = abs(cos * cos_other + sin * sin_other), abs(sin * cos_other - cos * sin_other)
    length, width = half_other[0], half_other[1]
    return (
        abs(cos * dx + sin * dy) < half[0] + length * c + width * s
        and abs(-sin * dx + cos * dy) < half[1] + length * s + width * c
        and abs(cos_other * dx + sin_other * dy) < length + half[0] * c + half[1] * s
        and abs(-sin_other * dx + cos_other * dy) < width + half[0] * s + half[1] * c
    )
