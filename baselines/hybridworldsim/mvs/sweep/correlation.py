"""The compiled inner loops of plane-sweep stereo: strips of rows, each by one thread, each with all planes."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from mirror.arrays import AnyArray, Float32, Float64, UInt8

_STRIP_ROWS = 24
RADIUS = 2
"""Half the side of a window, rounded down: known to the compiler, which then needs a third less time."""

_SIDE = 2 * RADIUS + 1
_SLACK_PX = np.float32(1e-3)
"""What single precision may put a pixel of the border outside by."""

_NONE = np.float32(-2.0)
"""A score where there is none: below every correlation."""

UNKNOWN = np.uint8(255)
"""The cost of a depth that no source sees."""

COSTS = 254.0
"""The cost of a correlation of -1; that of 1 is 0."""


def cost_volume(
    reference: Float32,
    sources: Sequence[Float32],
    homographies: Float64,
    inverse_depth: Float64,
    inverse_range: tuple[float, float],
    bins: int,
    *,
    best: int,
    deviation: float,
) -> UInt8:
    """How unlike its sources a picture's surroundings are, by pixel and depth.

    Args:
        reference: (H, W) grey; NaN where it does not count.
        sources: (S) pictures, likewise.
        homographies: (S, P, 3, 3) pixels of the reference to pixels of the source, by plane.
        inverse_depth: (P, 3) see `Planes.inverse_depth`.
        inverse_range: smallest and largest inverse depth.
        bins: number of depths, evenly spaced in inverse depth from the smallest to the largest.
        best: how many sources count.
        deviation: see `PlaneSweep`.

    Returns:
        (H, W, bins); at each depth that of the plane through it that fits best; `UNKNOWN` where there is none.
    """
    # At least two pixels each way, so that there is always something to interpolate between.
    height = max(2, *(len(source) for source in sources))
    width = max(2, *(source.shape[1] for source in sources))
    stack = np.full((len(sources), height, width), np.nan, np.float32)
    for number, source in enumerate(sources):
        stack[number, : source.shape[0], : source.shape[1]] = source
    arrays = (reference, stack, homographies, inverse_depth)
    low, high = inverse_range
    reference, stack, homographies, inverse_depth = (np.ascontiguousarray(array) for array in arrays)
    return _fill(reference, stack, homographies, inverse_depth, low, high, bins, best, deviation)


@numba.njit(cache=True, parallel=True, nogil=True)
def _fill(
    reference: AnyArray,
    sources: AnyArray,
    homographies: AnyArray,
    inverse_depth: AnyArray,
    low: float,
    high: float,
    bins: int,
    best: int,
    deviation: float,
) -> UInt8:
    height, width = reference.shape
    volume = np.full((height, width, bins), UNKNOWN, np.uint8)
    strips = (height + _STRIP_ROWS - 1) // _STRIP_ROWS
    for strip in numba.prange(strips):
        first = strip * _STRIP_ROWS
        rows = min(_STRIP_ROWS, height - first)
        own = _padded(reference, first, rows)
        mean, scale = _statistics(own, deviation)
        warped, places = np.empty_like(own), np.empty((2, own.shape[1]), np.float32)
        sums = np.empty((4, own.shape[1]), np.float32)
        kept = np.empty((best, rows, width), np.float32)
        for plane in range(len(inverse_depth)):
            start, end = _columns(inverse_depth[plane], first, rows, width, low, high)
            if start >= end:
                continue
            kept[:] = _NONE
            for source in range(len(sources)):
                h = homographies[source, plane]
                if _warp(sources[source], h, first - RADIUS, start, end + 2 * RADIUS, places, warped):
                    _correlate(own, warped, mean, scale, start, end, deviation, sums, kept)
            _enter(kept, inverse_depth[plane], first, start, end, low, high, volume[first : first + rows])
    return volume


@numba.njit(cache=True, nogil=True)
def _padded(picture: AnyArray, first: int, rows: int) -> Float32:
    """A strip with its halo: (rows + 2 radius, W + 2 radius), NaN beyond the picture."""
    height, width = picture.shape
    out = np.full((rows + 2 * RADIUS, width + 2 * RADIUS), np.nan, np.float32)
    for row in range(max(first - RADIUS, 0), min(first + rows + RADIUS, height)):
        out[row - first + RADIUS, RADIUS : RADIUS + width] = picture[row]
    return out


@numba.njit(cache=True, nogil=True)
def _statistics(own: AnyArray, deviation: float) -> tuple[Float32, Float32]:
    """Mean and inverse standard deviation (rows, W) of the windows of a strip; NaN without texture or not whole."""
    rows, width = own.shape[0] - _SIDE + 1, own.shape[1] - _SIDE + 1
    mean, scale = np.empty((rows, width), np.float32), np.full((rows, width), np.nan, np.float32)
    for row in range(rows):
        for column in range(width):
            total, square = 0.0, 0.0
            for i in range(_SIDE):
                for j in range(_SIDE):
                    value = own[row + i, column + j]
                    total += value
                    square += value * value
            total /= _SIDE * _SIDE
            mean[row, column] = total
            variance = square / (_SIDE * _SIDE) - total * total
            if variance > deviation * deviation:
                scale[row, column] = 1.0 / np.sqrt(variance)
    return mean, scale


@numba.njit(cache=True, nogil=True)
def _columns(plane: AnyArray, first: int, rows: int, width: int, low: float, high: float) -> tuple[int, int]:
    """The columns (start, end) of a strip outside of which a plane's depth is none that is searched."""
    a, b, c = plane[0], plane[1], plane[2]
    above, below = b * first + c, b * (first + rows) + c
    most, least = max(above, below), min(above, below)
    start, end = 0.0, float(width)
    # a u + most >= low and a u + least <= high.
    for slope, limit in ((a, low - most), (-a, least - high)):
        if slope > 0.0:
            start = max(start, limit / slope)
        elif slope < 0.0:
            end = min(end, limit / slope)
        elif limit > 0.0:
            return 0, 0
    # As integers they may be too large: planes that hardly slope.
    return int(np.floor(min(start, float(width)))), int(np.ceil(max(end, 0.0)))


@numba.njit(cache=True, nogil=True)
def _warp(source: AnyArray, h: AnyArray, first: int, start: int, end: int, places: AnyArray, out: AnyArray) -> bool:
    """Fill columns of a strip with the source's grey at where the plane takes each pixel; whether any is inside."""
    height, width = source.shape
    right, bottom = np.float32(width - 1.0), np.float32(height - 1.0)
    count, any_inside = end - start, False
    half, one = np.float32(0.5), np.float32(1.0)
    dx, dy, dz = np.float32(h[0, 0]), np.float32(h[1, 0]), np.float32(h[2, 0])
    x, y = places[0], places[1]
    for row in range(out.shape[0]):
        v = first + row + 0.5
        # Relative to the first column, so that single precision does.
        u = start - RADIUS + 0.5
        x0 = np.float32(h[0, 0] * u + h[0, 1] * v + h[0, 2])
        y0 = np.float32(h[1, 0] * u + h[1, 1] * v + h[1, 2])
        z0 = np.float32(h[2, 0] * u + h[2, 1] * v + h[2, 2])
        for column in range(count):
            offset = np.float32(column)
            z = z0 + dz * offset
            inverse = one / z if z > np.float32(1e-9) else np.float32(np.nan)
            x[column] = (x0 + dx * offset) * inverse - half
            y[column] = (y0 + dy * offset) * inverse - half
        for column in range(count):
            s, t = x[column], y[column]
            value = np.float32(np.nan)
            if s >= -_SLACK_PX and t >= -_SLACK_PX and s <= right + _SLACK_PX and t <= bottom + _SLACK_PX:
                s, t = min(max(s, np.float32(0.0)), right), min(max(t, np.float32(0.0)), bottom)
                left, top = min(np.int32(s), np.int32(width - 2)), min(np.int32(t), np.int32(height - 2))
                a, b = s - np.float32(left), t - np.float32(top)
                above = source[top, left] + a * (source[top, left + 1] - source[top, left])
                below = source[top + 1, left] + a * (source[top + 1, left + 1] - source[top + 1, left])
                value = above + b * (below - above)
                any_inside = True
            out[row, start + column] = value
    return any_inside


@numba.njit(cache=True, nogil=True)
def _correlate(
    own: AnyArray,
    warped: AnyArray,
    mean: AnyArray,
    scale: AnyArray,
    start: int,
    end: int,
    deviation: float,
    sums: AnyArray,
    kept: AnyArray,
) -> None:
    """Put a source's correlations of columns of a strip among the best so far; those with a NaN are left out."""
    share = np.float32(1.0 / (_SIDE * _SIDE))
    least = np.float32(deviation * deviation)
    width = end - start
    wide = width + 2 * RADIUS
    d0, d1, d2, score = sums[0, :wide], sums[1, :wide], sums[2, :wide], sums[3, :width]
    for row in range(mean.shape[0]):
        for column in range(wide):
            value = warped[row, start + column]
            d0[column], d1[column], d2[column] = value, value * value, value * own[row, start + column]
        for tap in range(1, _SIDE):
            for column in range(wide):
                value = warped[row + tap, start + column]
                d0[column] += value
                d1[column] += value * value
                d2[column] += value * own[row + tap, start + column]
        for column in range(width):
            total, square, product = d0[column], d1[column], d2[column]
            for tap in range(1, _SIDE):
                total += d0[column + tap]
                square += d1[column + tap]
                product += d2[column + tap]
            other = total * share
            variance = square * share - other * other
            # A NaN compares false, so that the window is left out.
            found = (product * share - mean[row, start + column] * other) * scale[row, start + column]
            root = np.sqrt(variance if variance > least else np.float32(1.0))
            score[column] = found / root if variance > least and found == found else _NONE
        for place in range(len(kept)):
            for column in range(width):
                held, new = kept[place, row, start + column], score[column]
                kept[place, row, start + column] = new if new > held else held
                score[column] = held if new > held else new


@numba.njit(cache=True, nogil=True)
def _enter(
    kept: AnyArray, plane: AnyArray, first: int, start: int, end: int, low: float, high: float, volume: AnyArray
) -> None:
    """Enter the mean of the best correlations at the depths of a plane, where none is better already."""
    rows, bins = volume.shape[0], volume.shape[2]
    scale = (bins - 1) / (high - low)
    for row in range(rows):
        v = first + row + 0.5
        for column in range(start, end):
            place = (plane[0] * (column + 0.5) + plane[1] * v + plane[2] - low) * scale
            if place < -0.5 or place >= bins - 0.5 or kept[0, row, column] == _NONE:
                continue
            total, count = np.float32(0.0), 0
            for rank in range(len(kept)):
                if kept[rank, row, column] > _NONE:
                    total += kept[rank, row, column]
                    count += 1
            score = np.float32(min(max(total / count, np.float32(-1.0)), np.float32(1.0)))
            cost = np.uint8((1.0 - score) * (0.5 * COSTS) + 0.5)
            index = int(place + 0.5)
            if cost < volume[row, column, index]:
                volume[row, column, index] = cost
