"""Compiled projection of points on lanes."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.compiled import compiled_above, inner_njit

# Segments in one bounding box; points outside it are farther from them than half of the lane's width.
_GROUP = 16
_PLAIN_ELEMENTS: Final = 100_000
"""Elements of arrays below which the functions run as plain Python: ten drives of ten seconds."""


@inner_njit
def _bounds(line: Float64, reach: float) -> Float64:
    """Bounding boxes (G, 4) of groups of segments, widened: least x, least y, largest x, largest y."""
    groups = (len(line) - 1 + _GROUP - 1) // _GROUP
    bounds = np.empty((groups, 4))
    for group in range(groups):
        part = line[group * _GROUP : (group + 1) * _GROUP + 1]
        bounds[group, 0], bounds[group, 1] = part[:, 0].min() - reach, part[:, 1].min() - reach
        bounds[group, 2], bounds[group, 3] = part[:, 0].max() + reach, part[:, 1].max() + reach
    return bounds


@compiled_above(_PLAIN_ELEMENTS)
def project_on_lanes(points: Float64, line: Float64, half: Float64, first: Int64) -> tuple[Float64, Float64, Float64]:
    """Return the offsets, lengths and directions (P, L) of points on lanes; NaN where a point is not in a lane.

    A point is in a lane if the nearest point of the middle line lies between the line's ends, and is not farther than
    half of the width there.

    Args:
        points: (P, 2) points.
        line: (K, 3) x, y and length along the middle line of the points of all lanes, one lane after the other.
        half: (K,) half of the lanes' widths at these points.
        first: (L + 1,) index of each lane's first point, and K.
    """
    lanes = len(first) - 1
    offset = np.full((len(points), lanes), math.nan)
    along, direction = offset.copy(), offset.copy()
    for lane in range(lanes):
        begin, end = first[lane], first[lane + 1]
        reach = half[begin:end].max()
        bounds = _bounds(line[begin:end], reach)
        low_x, low_y = bounds[:, 0].min(), bounds[:, 1].min()
        high_x, high_y = bounds[:, 2].max(), bounds[:, 3].max()
        for point in range(len(points)):
            x, y = points[point, 0], points[point, 1]
            if not (low_x <= x <= high_x and low_y <= y <= high_y):
                continue
            least, nearest, share = math.inf, -1, 0.0
            for group in range(len(bounds)):
                box = bounds[group]
                if not (box[0] <= x <= box[2] and box[1] <= y <= box[3]):
                    continue
                low = begin + group * _GROUP
                for k in range(low, min(low + _GROUP, end - 1)):
                    ax, ay = x - line[k, 0], y - line[k, 1]
                    ux, uy = line[k + 1, 0] - line[k, 0], line[k + 1, 1] - line[k, 1]
                    square = ux * ux + uy * uy
                    if square == 0.0:
                        continue
                    # Beyond the ends of the lane the foot is outside it.
                    at = (ax * ux + ay * uy) / square
                    if not ((k == begin and at < 0.0) or (k == end - 2 and at > 1.0)):
                        at = min(max(at, 0.0), 1.0)
                    near = min(max(at, 0.0), 1.0)
                    dx, dy = ax - near * ux, ay - near * uy
                    distance = dx * dx + dy * dy
                    if distance < least:
                        least, nearest, share = distance, k, at
            if nearest < 0 or share < 0.0 or share > 1.0:
                continue
            width = (1.0 - share) * half[nearest] + share * half[nearest + 1]
            if least > width * width:
                continue
            ux = line[nearest + 1, 0] - line[nearest, 0]
            uy = line[nearest + 1, 1] - line[nearest, 1]
            cross = ux * (y - line[nearest, 1]) - uy * (x - line[nearest, 0])
            offset[point, lane] = math.copysign(math.sqrt(least), cross)
            along[point, lane] = line[nearest, 2] + share * (line[nearest + 1, 2] - line[nearest, 2])
            direction[point, lane] = math.atan2(uy, ux)
    return offset, along, direction


@compiled_above(_PLAIN_ELEMENTS)
def project_on_line(points: Float64, line: Float64) -> tuple[Float64, Float64]:
    """Return the lengths and signed offsets (P,) of the feet of points (P, 2) on a line (K, 3) of x, y and length.

    The first point takes the nearest foot. Each later one takes the nearest foot that lies at most twice as far from
    the last foot as the points are apart, or 1 m, so that a line that crosses itself is followed, not jumped on.
    """
    along, offset = np.empty(len(points)), np.empty(len(points))
    low, high = -math.inf, math.inf
    for point in range(len(points)):
        x, y = points[point, 0], points[point, 1]
        if point > 0:
            moved = math.hypot(x - points[point - 1, 0], y - points[point - 1, 1])
            low, high = along[point - 1] - 2.0 * moved - 1.0, along[point - 1] + 2.0 * moved + 1.0
        least, at, side = math.inf, 0.0, 0.0
        for k in range(len(line) - 1):
            if line[k + 1, 2] < low or line[k, 2] > high:
                continue
            ax, ay = x - line[k, 0], y - line[k, 1]
            ux, uy = line[k + 1, 0] - line[k, 0], line[k + 1, 1] - line[k, 1]
            square = ux * ux + uy * uy
            share = min(max((ax * ux + ay * uy) / square, 0.0), 1.0) if square > 0.0 else 0.0
            dx, dy = ax - share * ux, ay - share * uy
            distance = dx * dx + dy * dy
            if distance < least:
                least, at = distance, line[k, 2] + share * (line[k + 1, 2] - line[k, 2])
                side = math.copysign(math.sqrt(distance), ux * ay - uy * ax)
        along[point], offset[point] = at, side
    return along, offset
