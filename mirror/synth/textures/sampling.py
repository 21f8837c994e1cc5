"""Means of grains and images over a pixel: taps over its parallelogram, each on a level that matches its part.

A tap reads the nearest level of detail bilinearly, which is a kernel about 1.7 texels wide. Pixels up to about twice as
long as wide use two rows of taps, longer pixels one row. The error against a box mean is about a tenth of its remaining
contrast, for white noise a fourth. ``python -m benchmarks textures`` measures times and errors.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Float32, Float64, Int64, UInt8
from mirror.compiled import inner_per_pixel, per_pixel

_CLOSE: Final = 1.25
"""Number of taps of a single row per width of the pixel along its length."""
_MOST_TAPS: Final = 10
_STEEPEST: Final = 64.0
"""Square of the greatest aspect of a pixel; longer pixels are widened to this aspect."""
_BELL: Final = 0.45
"""Square of a tap's texel divided by the square of the width that the tap represents. A third gives the kernel the
variance of the box; a larger value removes more of the high frequencies that the kernel passes."""
_NEAREST: Final = 2.5
"""Square of a tap's texel, in texels, above which the next level is nearer."""
_SMALL: Final = 1.0
"""Square of the width, in texels, below which one row of taps is enough."""
_SHARE: Final = np.array([0.0, *(1.0 / n for n in range(1, _MOST_TAPS + 1))])
_WHOLE: Final = 65536
_HALF: Final = 32768

Rgb = tuple[float, float, float]
_Tap = tuple[np.float32, np.float32, np.float32]


@per_pixel()
def grain_at(
    grains: Float32, index: Float64, grain: int, u: float, v: float, u1: float, v1: float, u2: float, v2: float
) -> float:
    """Compute the mean of a grain over a pixel.

    Args:
        grains: ``Atlas.grains``.
        index: ``Atlas.grain_index``.
        grain: value of ``Grain``.
        u: centre of the pixel on the surface, metres.
        v: centre of the pixel on the surface, metres.
        u1: change of u across the pixel from left to right, metres.
        v1: change of v across the pixel from left to right, metres.
        u2: change of u across the pixel from top to bottom, metres.
        v2: change of v across the pixel from top to bottom, metres.

    Returns:
        Factor of the reflectance, with mean 1 over the surface.
    """
    scale = index[grain, 2]
    x1, y1, x2, y2, texel, taps, rows = _spread(u1 * scale, v1 * scale, u2 * scale, v2 * scale)
    first, log, flat = int(index[grain, 0]), int(index[grain, 1]), int(index[grain, 3])
    level, shrink = 0, float(_WHOLE)
    while texel >= _NEAREST and level < flat:
        texel *= 0.25
        first += 1 << (2 * log)
        log -= 1
        level += 1
        shrink *= 0.5
    if level >= flat:
        return 1.0
    # Integers in 65536ths of a texel: the lower bits are the position within a period.
    x1, y1, x2, y2 = int(x1 * shrink), int(y1 * shrink), int(x2 * shrink), int(y2 * shrink)
    left = int(u * scale * shrink) - _HALF - (((taps - 1) * x1 + (rows - 1) * x2) >> 1)
    top = int(v * scale * shrink) - _HALF - (((taps - 1) * y1 + (rows - 1) * y2) >> 1)
    total = np.float32(0.0)
    for row in range(rows):
        x, y = left + row * x2, top + row * y2
        for _ in range(taps):
            total += _grain_tap(grains, first, log, x, y)
            x, y = x + x1, y + y1
    return total * (_SHARE[taps] * _SHARE[rows])


@inner_per_pixel(inline="always")
def _spread(x1: float, y1: float, x2: float, y2: float) -> tuple[float, float, float, float, float, int, int]:
    """Distribute taps over a parallelogram.

    Returns:
        The step between taps, the step between rows, the square of the texel that fits a tap, the number of taps in a
        row, and the number of rows.
    """
    long, short = x1 * x1 + y1 * y1, x2 * x2 + y2 * y2
    area = x1 * y2 - x2 * y1
    if short > long:
        x1, y1, x2, y2, long = x2, y2, x1, y1, short
    short = max(area * area / max(long, 1e-12), long * (1.0 / _STEEPEST))
    # A bilinear tap is at least the square root of 3 texels wide.
    wide, reach, taps, rows = max(short, 3.0), long * (_CLOSE * _CLOSE), 1, 1
    while (taps + 0.5) * (taps + 0.5) * wide < reach and taps < _MOST_TAPS:
        taps += 1
    if taps <= 2 and short > _SMALL:
        taps, rows, short = taps + 1, 2, 0.25 * short
    along, across = _SHARE[taps], _SHARE[rows]
    return along * x1, along * y1, across * x2, across * y2, 1.0 + _BELL * short, taps, rows


@inner_per_pixel(inline="always")
def _grain_tap(grains: Float32, first: int, log: int, x: int, y: int) -> float:
    mask, i, j = (1 << log) - 1, x >> 16, y >> 16
    a, b = np.float32(x & 65535) * np.float32(1.0 / _WHOLE), np.float32(y & 65535) * np.float32(1.0 / _WHOLE)
    left, right = i & mask, (i + 1) & mask
    below, above = first + ((j & mask) << log), first + (((j + 1) & mask) << log)
    under = grains[below + left] + (grains[below + right] - grains[below + left]) * a
    over = grains[above + left] + (grains[above + right] - grains[above + left]) * a
    return under + (over - under) * b


@per_pixel()
def image_at(
    images: UInt8, index: Int64, image: int, s: float, t: float, s1: float, t1: float, s2: float, t2: float
) -> Rgb:
    """Compute the mean of an image over a pixel; the outermost texels continue beyond the edges.

    Args:
        images: ``Atlas.images``.
        index: ``Atlas.image_index``.
        image: number of the image in the catalogue.
        s: centre of the pixel, 0 at the left edge of the image, 1 at the right edge.
        t: centre of the pixel, 0 at the lower edge of the image, 1 at the upper edge.
        s1: change of s across the pixel from left to right.
        t1: change of t across the pixel from left to right.
        s2: change of s across the pixel from top to bottom.
        t2: change of t across the pixel from top to bottom.

    Returns:
        Linear reflectance of red, green and blue, 0 to 1.
    """
    wide, high, levels = index[image, 0], index[image, 1], index[image, 2]
    x1, y1, x2, y2, texel, taps, rows = _spread(s1 * wide, -t1 * high, s2 * wide, -t2 * high)
    level, shrink = 0, float(_WHOLE)
    while texel >= _NEAREST and level < levels - 1:
        texel *= 0.25
        level += 1
        shrink *= 0.5
    x1, y1, x2, y2 = int(x1 * shrink), int(y1 * shrink), int(x2 * shrink), int(y2 * shrink)
    left = int(s * wide * shrink) - _HALF - (((taps - 1) * x1 + (rows - 1) * x2) >> 1)
    top = int((1.0 - t) * high * shrink) - _HALF - (((taps - 1) * y1 + (rows - 1) * y2) >> 1)
    first, width, height = index[image, 3 + level], wide >> level, high >> level
    red, green, blue = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for row in range(rows):
        x, y = left + row * x2, top + row * y2
        for _ in range(taps):
            r, g, b = _image_tap(images, first, width, height, x, y)
            red, green, blue = red + r, green + g, blue + b
            x, y = x + x1, y + y1
    scale = _SHARE[taps] * _SHARE[rows] / 65025.0
    return red * scale, green * scale, blue * scale


@inner_per_pixel(inline="always")
def _image_tap(images: UInt8, first: int, wide: int, high: int, x: int, y: int) -> _Tap:
    """One bilinear tap of an image: linear reflectance times 255 squared."""
    x, y = min(max(x, 0), (wide - 1) << 16), min(max(y, 0), (high - 1) << 16)
    i, j = x >> 16, y >> 16
    a, b = np.float32(x & 65535) * np.float32(1.0 / _WHOLE), np.float32(y & 65535) * np.float32(1.0 / _WHOLE)
    near = first + j * wide + i
    right = near + 1 if i < wide - 1 else near
    down = wide if j < high - 1 else 0
    ab = a * b
    one, two, three, four = np.float32(1.0) - a - b + ab, a - ab, b - ab, ab
    red, green, blue = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for at, share in ((near, one), (right, two), (near + down, three), (right + down, four)):
        r, g, b = np.float32(images[at, 0]), np.float32(images[at, 1]), np.float32(images[at, 2])
        red += share * r * r
        green += share * g * g
        blue += share * b * b
    return red, green, blue
