"""The compiled inner loops of plane-sweep stereo: each thread computes all planes of one strip of rows."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from hybridworldsim.kernels.threads import in_parallel, numba_threads
from mirror.arrays import AnyArray, Float32, Float64, UInt8
from mirror.compiled import inner_njit

_STRIP_ROWS = 24
RADIUS = 2
"""Half the side of a window, rounded down; as a constant of the compiler it saves a third of the time."""

_SIDE = 2 * RADIUS + 1
_SLACK_PX = np.float32(1e-3)
"""By how much single precision may position a border pixel outside the image."""

_NONE = np.float32(-2.0)
"""A missing score: below each correlation."""

UNKNOWN = np.uint8(255)
"""The cost of a depth that no source sees."""

COSTS = 254.0
"""The cost of a correlation of -1; the cost of a correlation of 1 is 0."""


def compute_cost_volume(
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
    """Compute, for each depth, how much the window around each pixel differs from the sources.

    Args:
        reference: (H, W) grey; NaN where it does not count.
        sources: S images (H', W') of the same kind.
        homographies: (S, P, 3, 3) from pixels of the reference to pixels of the source, by plane.
        inverse_depth: (P, 3) see `Planes.compute_inverse_depth`.
        inverse_range: smallest and largest inverse depth, 1 / m.
        bins: number of depths, evenly spaced in inverse depth from the smallest to the largest.
        best: number of best sources that count.
        deviation: least standard deviation of a window, see `PlaneSweep.least_deviation`.

    Returns:
        (H, W, bins); at each depth the cost of the best plane through it; `UNKNOWN` without such a plane.
    """
    # Interpolation needs at least two pixels in each direction.
    height = max(2, *(len(source) for source in sources))
    width = max(2, *(source.shape[1] for source in sources))
    stack = np.full((len(sources), height, width), np.nan, np.float32)
    for number, source in enumerate(sources):
        stack[number, : source.shape[0], : source.shape[1]] = source
    arrays = (reference, stack, homographies, inverse_depth)
    low, high = inverse_range
    reference, stack, homographies, inverse_depth = (np.ascontiguousarray(array) for array in arrays)
    volume = np.full((*reference.shape, bins), UNKNOWN, np.uint8)
    fixed = (reference, stack, homographies, inverse_depth, low, high, best, deviation, volume)
    strips = -(-len(reference) // _STRIP_ROWS)
    in_parallel(lambda strip: _fill(*fixed, strip * _STRIP_ROWS), strips, numba_threads())
    return volume


@numba.njit(cache=True, nogil=True)
def _fill(
    reference: AnyArray,
    sources: AnyArray,
    homographies: AnyArray,
    inverse_depth: AnyArray,
    low: float,
    high: float,
    best: int,
    deviation: float,
    volume: AnyArray,
    first: int,
) -> None:
    """Compute all planes of the strip of rows that begins at ``first``."""
    height, width = reference.shape
    rows = min(_STRIP_ROWS, height - first)
    grey = _pad_strip(reference, first, rows)
    mean, scale = _compute_statistics(grey, deviation)
    warped, coordinates = np.empty_like(grey), np.empty((2, grey.shape[1]), np.float32)
    sums = np.empty((4, grey.shape[1]), np.float32)
    best_scores = np.empty((best, rows, width), np.float32)
    for plane in range(len(inverse_depth)):
        start, end = _find_columns(inverse_depth[plane], first, rows, width, low, high)
        if start >= end:
            continue
        best_scores[:] = _NONE
        for source in range(len(sources)):
            h = homographies[source, plane]
            if _warp(sources[source], h, first - RADIUS, start, end + 2 * RADIUS, coordinates, warped):
                _correlate(grey, warped, mean, scale, start, end, deviation, sums, best_scores)
        _enter_costs(best_scores, inverse_depth[plane], first, start, end, low, high, volume[first : first + rows])


@inner_njit
def _pad_strip(image: AnyArray, first: int, rows: int) -> Float32:
    """Copy a strip with a halo: (rows + 2 radius, W + 2 radius), NaN outside the image."""
    height, width = image.shape
    out = np.full((rows + 2 * RADIUS, width + 2 * RADIUS), np.nan, np.float32)
    for row in range(max(first - RADIUS, 0), min(first + rows + RADIUS, height)):
        # Not a slice: the error of shapes that differ takes three seconds to compile.
        for column in range(width):
            out[row - first + RADIUS, RADIUS + column] = image[row, column]
    return out


@inner_njit
def _compute_statistics(grey: AnyArray, deviation: float) -> tuple[Float32, Float32]:
    """Compute the mean and inverse standard deviation (rows, W) of the windows of a strip.

    The inverse is NaN for a window without texture or with a NaN.
    """
    rows, width = grey.shape[0] - _SIDE + 1, grey.shape[1] - _SIDE + 1
    mean, scale = np.empty((rows, width), np.float32), np.full((rows, width), np.nan, np.float32)
    for row in range(rows):
        for column in range(width):
            total, square = 0.0, 0.0
            for i in range(_SIDE):
                for j in range(_SIDE):
                    value = grey[row + i, column + j]
                    total += value
                    square += value * value
            total /= _SIDE * _SIDE
            mean[row, column] = total
            variance = square / (_SIDE * _SIDE) - total * total
            if variance > deviation * deviation:
                scale[row, column] = 1.0 / np.sqrt(variance)
    return mean, scale


@inner_njit
def _find_columns(plane: AnyArray, first: int, rows: int, width: int, low: float, high: float) -> tuple[int, int]:
    """Find the columns (start, end) of a strip in which a plane's inverse depth can lie between low and high."""
    a, b, c = plane[0], plane[1], plane[2]
    above, below = b * first + c, b * (first + rows) + c
    highest, lowest = max(above, below), min(above, below)
    start, end = 0.0, float(width)
    # a u + highest >= low and a u + lowest <= high.
    for slope, limit in ((a, low - highest), (-a, lowest - high)):
        if slope > 0.0:
            start = max(start, limit / slope)
        elif slope < 0.0:
            end = min(end, limit / slope)
        elif limit > 0.0:
            return 0, 0
    # A plane with a very small slope gives bounds beyond the range of integers.
    return int(np.floor(min(start, float(width)))), int(np.ceil(max(end, 0.0)))


@inner_njit
def _warp(
    source: AnyArray, h: AnyArray, first: int, start: int, end: int, coordinates: AnyArray, out: AnyArray
) -> bool:
    """Warp the source's grey values by a homography into columns of a strip; return whether any pixel is inside."""
    height, width = source.shape
    right, bottom = np.float32(width - 1.0), np.float32(height - 1.0)
    count, any_inside = end - start, False
    half, one = np.float32(0.5), np.float32(1.0)
    dx, dy, dz = np.float32(h[0, 0]), np.float32(h[1, 0]), np.float32(h[2, 0])
    x, y = coordinates[0], coordinates[1]
    for row in range(out.shape[0]):
        v = first + row + 0.5
        # Coordinates relative to the first column keep single precision exact enough.
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
    grey: AnyArray,
    warped: AnyArray,
    mean: AnyArray,
    scale: AnyArray,
    start: int,
    end: int,
    deviation: float,
    sums: AnyArray,
    best_scores: AnyArray,
) -> None:
    """Correlate columns of a strip with a source, and insert the scores into the sorted best scores.

    Windows with a NaN get no score.
    """
    share = np.float32(1.0 / (_SIDE * _SIDE))
    lowest = np.float32(deviation * deviation)
    width = end - start
    wide = width + 2 * RADIUS
    d0, d1, d2, score = sums[0, :wide], sums[1, :wide], sums[2, :wide], sums[3, :width]
    for row in range(mean.shape[0]):
        for column in range(wide):
            value = warped[row, start + column]
            d0[column], d1[column], d2[column] = value, value * value, value * grey[row, start + column]
        for tap in range(1, _SIDE):
            for column in range(wide):
                value = warped[row + tap, start + column]
                d0[column] += value
                d1[column] += value * value
                d2[column] += value * grey[row + tap, start + column]
        for column in range(width):
            total, square, product = d0[column], d1[column], d2[column]
            for tap in range(1, _SIDE):
                total += d0[column + tap]
                square += d1[column + tap]
                product += d2[column + tap]
            other = total * share
            variance = square * share - other * other
            # NaN compares false, which leaves the window out.
            correlation = (product * share - mean[row, start + column] * other) * scale[row, start + column]
            root = np.sqrt(variance if variance > lowest else np.float32(1.0))
            score[column] = correlation / root if variance > lowest and correlation == correlation else _NONE
        for position in range(len(best_scores)):
            for column in range(width):
                current, new = best_scores[position, row, start + column], score[column]
                best_scores[position, row, start + column] = new if new > current else current
                score[column] = current if new > current else new


@inner_njit
def _enter_costs(
    best_scores: AnyArray, plane: AnyArray, first: int, start: int, end: int, low: float, high: float, volume: AnyArray
) -> None:
    """Write the cost of the mean best score into the volume at the plane's depths, where it is lower."""
    rows, bins = volume.shape[0], volume.shape[2]
    scale = (bins - 1) / (high - low)
    for row in range(rows):
        v = first + row + 0.5
        for column in range(start, end):
            position = (plane[0] * (column + 0.5) + plane[1] * v + plane[2] - low) * scale
            if position < -0.5 or position >= bins - 0.5 or best_scores[0, row, column] == _NONE:
                continue
            total, count = np.float32(0.0), 0
            for rank in range(len(best_scores)):
                if best_scores[rank, row, column] > _NONE:
                    total += best_scores[rank, row, column]
                    count += 1
            score = np.float32(min(max(total / count, np.float32(-1.0)), np.float32(1.0)))
            cost = np.uint8((1.0 - score) * (0.5 * COSTS) + 0.5)
            index = int(position + 0.5)
            if cost < volume[row, column, index]:
                volume[row, column, index] = cost
