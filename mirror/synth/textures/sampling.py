"""Means of grains and pictures over a pixel: taps along its long axis, each on a level that fits its short one."""

from __future__ import annotations

import math
from typing import Final

from numba import njit

from mirror.arrays import Float32, Float64, Int64, UInt8

MOST_TAPS: Final = 8

Rgb = tuple[float, float, float]


@njit(cache=True, nogil=True, error_model="numpy")
def grain_at(
    grains: Float32, index: Float64, grain: int, u: float, v: float, u1: float, v1: float, u2: float, v2: float
) -> float:
    """Mean of a grain over a parallelogram.

    Args:
        grains: ``Atlas.grains``.
        index: ``Atlas.grain_index``.
        grain: of ``Grain``.
        u: middle of the pixel on the surface, metres.
        v: metres.
        u1: how far u moves across the pixel from left to right, metres.
        v1: how far v does.
        u2: how far u moves across the pixel from top to bottom, metres.
        v2: how far v does.

    Returns:
        A factor of the reflectance, 1 in the mean.
    """
    scale = index[grain, 2]
    x, y = u * scale, v * scale
    x1, y1, x2, y2 = u1 * scale, v1 * scale, u2 * scale, v2 * scale
    long, wide = x1 * x1 + y1 * y1, x2 * x2 + y2 * y2
    if wide > long:
        x1, y1, long = x2, y2, wide
    width = abs(u1 * v2 - u2 * v1) * scale * scale / math.sqrt(max(long, 1e-12))
    taps = min(max(int(math.sqrt(long) / max(width, 1.0) + 0.5), 1), MOST_TAPS)
    spread = max(width, math.sqrt(long) / MOST_TAPS)
    level, first, size = 0, int(index[grain, 0]), int(index[grain, 1])
    while spread >= 2.4 and size > 1:
        spread *= 0.5
        first += size * size
        size >>= 1
        level += 1
    if level >= index[grain, 3]:
        return 1.0
    shrink = 1.0 / (1 << level)
    total = 0.0
    for tap in range(taps):
        along = (tap + 0.5) / taps - 0.5
        total += _tap(grains, first, size, (x + along * x1) * shrink - 0.5, (y + along * y1) * shrink - 0.5)
    return total / taps


@njit(cache=True, nogil=True, error_model="numpy")
def _tap(texels: Float32, first: int, size: int, x: float, y: float) -> float:
    i, j = math.floor(x), math.floor(y)
    a, b = x - i, y - j
    left, low = int(i) & (size - 1), int(j) & (size - 1)
    right, high = (left + 1) & (size - 1), (low + 1) & (size - 1)
    below, above = first + low * size, first + high * size
    under = texels[below + left] * (1.0 - a) + texels[below + right] * a
    return under * (1.0 - b) + (texels[above + left] * (1.0 - a) + texels[above + right] * a) * b


@njit(cache=True, nogil=True, error_model="numpy")
def image_at(
    images: UInt8, index: Int64, image: int, s: float, t: float, s1: float, t1: float, s2: float, t2: float
) -> Rgb:
    """Mean of a picture over a parallelogram; its edge goes on outside.

    Args:
        images: ``Atlas.images``.
        index: ``Atlas.image_index``.
        image: number in the catalogue.
        s: middle of the pixel, 0 at the picture's left edge, 1 at its right one.
        t: 0 at its lower edge, 1 at its upper one.
        s1: how far s moves across the pixel from left to right.
        t1: how far t does.
        s2: how far s moves across the pixel from top to bottom.
        t2: how far t does.

    Returns:
        Linear reflectance of red, green and blue, 0 to 1.
    """
    wide, high, levels = index[image, 0], index[image, 1], index[image, 2]
    x, y = s * wide, (1.0 - t) * high
    x1, y1, x2, y2 = s1 * wide, -t1 * high, s2 * wide, -t2 * high
    area = abs(x1 * y2 - x2 * y1)
    long = x1 * x1 + y1 * y1
    if x2 * x2 + y2 * y2 > long:
        x1, y1, long = x2, y2, x2 * x2 + y2 * y2
    width = area / math.sqrt(max(long, 1e-12))
    taps = min(max(int(math.sqrt(long) / max(width, 1.0) + 0.5), 1), MOST_TAPS)
    spread = max(width, math.sqrt(long) / MOST_TAPS)
    level = 0
    while spread >= 2.4 and level < levels - 1:
        spread *= 0.5
        level += 1
    first, shrink = index[image, 3 + level], 1.0 / (1 << level)
    wide, high = wide >> level, high >> level
    red, green, blue = 0.0, 0.0, 0.0
    for tap in range(taps):
        along = (tap + 0.5) / taps - 0.5
        px = min(max((x + along * x1) * shrink - 0.5, 0.0), wide - 1.0)
        py = min(max((y + along * y1) * shrink - 0.5, 0.0), high - 1.0)
        i, j = int(px), int(py)
        a, b = px - i, py - j
        near = first + j * wide
        far = near + wide if j < high - 1 else near
        right = i + 1 if i < wide - 1 else i
        for corner, weight in (
            (near + i, (1.0 - a) * (1.0 - b)),
            (near + right, a * (1.0 - b)),
            (far + i, (1.0 - a) * b),
            (far + right, a * b),
        ):
            red += weight * images[corner, 0] ** 2
            green += weight * images[corner, 1] ** 2
            blue += weight * images[corner, 2] ** 2
    scale = 1.0 / (65025.0 * taps)
    return red * scale, green * scale, blue * scale
