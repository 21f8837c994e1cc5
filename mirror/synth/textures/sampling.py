"""Means of grains and pictures over a pixel: taps along its longer side, each as wide as the shorter one.

A tap reads a level of detail bilinearly; that is a bell about 1.7 texels wide. One or two taps mix two levels so that
the bell has the width of the pixel; from three on, the nearest level does, and closer taps are the better use of time.
Means over boxes are met to about a tenth of the pattern's contrast; ``python -m benchmarks synth`` has the figures.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float32, Float64, Int64, UInt8

_CLOSE: Final = 1.25
"""Taps for as much length as the pixel is wide."""
_MOST_TAPS: Final = 10
_STEEPEST: Final = 64.0
"""Square of the greatest ratio of sides; beyond it pixels are taken as wider than they are."""
_GRAIN_BELL: Final = 0.45
_PICTURE_BELL: Final = 1.0 / 3.0
"""Square of a tap's texel by that of the pixel's width. A third gives the bell the variance of the box; noise, which
has more power in fine waves than pictures of shapes, is met better by a wider one."""
_SINGLE: Final = 3
"""From as many taps on, one level is read."""
_NEAREST: Final = 2.5
"""The square of a tap's texel, in texels, from which the next level is the nearer one."""
_SHARE: Final = np.array([0.0, *(1.0 / n for n in range(1, _MOST_TAPS + 1))])
_WHOLE: Final = 65536
_HALF: Final = 32768

Rgb = tuple[float, float, float]
_Tap = tuple[np.float32, np.float32, np.float32]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def grain_at(
    grains: Float32, index: Float64, grain: int, u: float, v: float, u1: float, v1: float, u2: float, v2: float
) -> float:
    """Mean of a grain over a pixel.

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
    x1, y1, short, taps = _sides(u1 * scale, v1 * scale, u2 * scale, v2 * scale)
    first, log, flat = int(index[grain, 0]), int(index[grain, 1]), int(index[grain, 3])
    texel, level, shrink = 1.0 + _GRAIN_BELL * short, 0, float(_WHOLE)
    largest = 4.0 if taps < _SINGLE else _NEAREST
    while texel >= largest and level < flat:
        texel *= 0.25
        first += 1 << (2 * log)
        log -= 1
        level += 1
        shrink *= 0.5
    if level >= flat:
        return 1.0
    # In 65536ths of a texel: what is left of a period after a wrap is what the lower bits say.
    dx, dy = int(x1 * shrink * _SHARE[taps]), int(y1 * shrink * _SHARE[taps])
    x = int(u * scale * shrink) - _HALF - (((taps - 1) * dx) >> 1)
    y = int(v * scale * shrink) - _HALF - (((taps - 1) * dy) >> 1)
    total, coarse = np.float32(0.0), np.float32((texel - 1.0) * (1.0 / 3.0))
    if taps >= _SINGLE or texel <= 1.01:
        for _ in range(taps):
            total += _grain_tap(grains, first, log, x, y)
            x, y = x + dx, y + dy
    else:
        above = first + (1 << (2 * log))
        for _ in range(taps):
            fine = _grain_tap(grains, first, log, x, y)
            total += fine + (_grain_tap(grains, above, log - 1, (x - _HALF) >> 1, (y - _HALF) >> 1) - fine) * coarse
            x, y = x + dx, y + dy
    return total * _SHARE[taps]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sides(x1: float, y1: float, x2: float, y2: float) -> tuple[float, float, float, int]:
    """The longer side of a parallelogram, the square of the width across it, and the taps along it."""
    long, short = x1 * x1 + y1 * y1, x2 * x2 + y2 * y2
    area = x1 * y2 - x2 * y1
    if short > long:
        x1, y1, long, short = x2, y2, short, long
    short = max(area * area / max(long, 1e-12), long * (1.0 / _STEEPEST))
    # A bilinear tap is never narrower than the square root of 3 texels.
    wide, reach, taps = max(short, 3.0), long * (_CLOSE * _CLOSE), 1
    while (taps + 0.5) * (taps + 0.5) * wide < reach and taps < _MOST_TAPS:
        taps += 1
    if taps == 1:
        short = 0.5 * (short + long)
    return x1, y1, short, taps


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, inline="always")
def _grain_tap(grains: Float32, first: int, log: int, x: int, y: int) -> float:
    mask, i, j = (1 << log) - 1, x >> 16, y >> 16
    a, b = np.float32(x & 65535) * np.float32(1.0 / _WHOLE), np.float32(y & 65535) * np.float32(1.0 / _WHOLE)
    left, right = i & mask, (i + 1) & mask
    below, above = first + ((j & mask) << log), first + (((j + 1) & mask) << log)
    under = grains[below + left] + (grains[below + right] - grains[below + left]) * a
    over = grains[above + left] + (grains[above + right] - grains[above + left]) * a
    return under + (over - under) * b


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def image_at(
    images: UInt8, index: Int64, image: int, s: float, t: float, s1: float, t1: float, s2: float, t2: float
) -> Rgb:
    """Mean of a picture over a pixel; beyond its edges the outermost texels go on.

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
    x1, y1, short, taps = _sides(s1 * wide, -t1 * high, s2 * wide, -t2 * high)
    texel, level, shrink = 1.0 + _PICTURE_BELL * short, 0, float(_WHOLE)
    largest = 4.0 if taps < _SINGLE else _NEAREST
    while texel >= largest and level < levels - 1:
        texel *= 0.25
        level += 1
        shrink *= 0.5
    dx, dy = int(x1 * shrink * _SHARE[taps]), int(y1 * shrink * _SHARE[taps])
    x = int(s * wide * shrink) - _HALF - (((taps - 1) * dx) >> 1)
    y = int((1.0 - t) * high * shrink) - _HALF - (((taps - 1) * dy) >> 1)
    first, width, height = index[image, 3 + level], wide >> level, high >> level
    red, green, blue = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    scale = np.float32(_SHARE[taps] / 65025.0)
    if taps >= _SINGLE or texel <= 1.01 or level == levels - 1:
        for _ in range(taps):
            r, g, b = _image_tap(images, first, width, height, x, y)
            red, green, blue = red + r, green + g, blue + b
            x, y = x + dx, y + dy
        return float(red * scale), float(green * scale), float(blue * scale)
    above, coarse = index[image, 4 + level], np.float32((texel - 1.0) * (1.0 / 3.0))
    for _ in range(taps):
        r, g, b = _image_tap(images, first, width, height, x, y)
        far_r, far_g, far_b = _image_tap(images, above, width >> 1, height >> 1, (x - _HALF) >> 1, (y - _HALF) >> 1)
        red += r + (far_r - r) * coarse
        green += g + (far_g - g) * coarse
        blue += b + (far_b - b) * coarse
        x, y = x + dx, y + dy
    return float(red * scale), float(green * scale), float(blue * scale)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, inline="always")
def _image_tap(images: UInt8, first: int, wide: int, high: int, x: int, y: int) -> _Tap:
    """Times 255 squared."""
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
