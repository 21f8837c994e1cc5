"""Compiled signed distance of points from the edge of an area."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.compiled import compiled_above, inner_njit

# Segments in one bounding box: a box that is farther than the nearest segment so far is passed over whole.
_GROUP = 16
_PLAIN_ELEMENTS: Final = 20_000
"""Elements of arrays below which the functions run as plain Python: a drive of ten seconds."""


@inner_njit
def _bounds(begins: Float64, ends: Float64) -> Float64:
    """Bounding boxes (G, 4) of groups of segments: least x, least y, largest x, largest y."""
    groups = (len(begins) + _GROUP - 1) // _GROUP
    bounds = np.empty((groups, 4))
    bounds[:, :2], bounds[:, 2:] = math.inf, -math.inf
    for segment in range(len(begins)):
        box = bounds[segment // _GROUP]
        for axis in range(2):
            box[axis] = min(box[axis], begins[segment, axis], ends[segment, axis])
            box[axis + 2] = max(box[axis + 2], begins[segment, axis], ends[segment, axis])
    return bounds


@inner_njit
def _signed_distance(x: float, y: float, bounds: Float64, begins: Float64, ends: Float64) -> float:
    """Distance of a point from segments: positive inside (even-odd rule), else negative."""
    least, inside = math.inf, False
    for group in range(len(bounds)):
        box = bounds[group]
        gap_x, gap_y = max(box[0] - x, x - box[2], 0.0), max(box[1] - y, y - box[3], 0.0)
        # The ray of the even-odd rule goes from the point along x.
        if gap_x * gap_x + gap_y * gap_y >= least and not (box[1] <= y <= box[3] and box[2] >= x):
            continue
        for segment in range(group * _GROUP, min((group + 1) * _GROUP, len(begins))):
            ax, ay = begins[segment, 0] - x, begins[segment, 1] - y
            bx, by = ends[segment, 0] - x, ends[segment, 1] - y
            least = min(least, _square_from_origin(ax, ay, bx, by)[0])
            if (ay > 0.0) != (by > 0.0) and (ax * by - ay * bx > 0.0) == (by > ay):
                inside = not inside
    return math.sqrt(least) if inside else -math.sqrt(least)


@inner_njit
def _square_from_origin(ax: float, ay: float, bx: float, by: float) -> tuple[float, float]:
    """Square of the distance of a segment from the origin, and the share of the segment that is nearest to it."""
    ux, uy = bx - ax, by - ay
    square = ux * ux + uy * uy
    share = min(max(-(ax * ux + ay * uy) / square, 0.0), 1.0) if square > 0.0 else 0.0
    nearest_x, nearest_y = ax + share * ux, ay + share * uy
    return nearest_x * nearest_x + nearest_y * nearest_y, share


@compiled_above(_PLAIN_ELEMENTS)
def signed_distances(points: Float64, begins: Float64, ends: Float64) -> Float64:
    """Return the distances (P,) of points (P, 2) from the segments between points (S, 2) and (S, 2).

    They are positive inside (even-odd rule), else negative.
    """
    bounds = _bounds(begins, ends)
    found = np.empty(len(points))
    for point in range(len(points)):
        found[point] = _signed_distance(points[point, 0], points[point, 1], bounds, begins, ends)
    return found


@inner_njit
def _clearance(path: Float64, bounds: Float64, begins: Float64, ends: Float64) -> tuple[float, float]:
    """Least distance of a path (x, y, x, y) from segments, 0 where it crosses one; and the share of the path there."""
    x, y, ux, uy = path[0], path[1], path[2] - path[0], path[3] - path[1]
    least, where = math.inf, 0.0
    low_x, high_x = min(path[0], path[2]), max(path[0], path[2])
    low_y, high_y = min(path[1], path[3]), max(path[1], path[3])
    for group in range(len(bounds)):
        box = bounds[group]
        gap_x, gap_y = max(box[0] - high_x, low_x - box[2], 0.0), max(box[1] - high_y, low_y - box[3], 0.0)
        if gap_x * gap_x + gap_y * gap_y >= least:
            continue
        for segment in range(group * _GROUP, min((group + 1) * _GROUP, len(begins))):
            ax, ay = begins[segment, 0] - x, begins[segment, 1] - y
            bx, by = ends[segment, 0] - x, ends[segment, 1] - y
            side_a, side_b = ux * ay - uy * ax, ux * by - uy * bx
            vx, vy = bx - ax, by - ay
            side_p, side_q = vy * ax - vx * ay, vy * (ax - ux) - vx * (ay - uy)
            if side_a * side_b < 0.0 and side_p * side_q < 0.0:
                return 0.0, side_p / (side_p - side_q)
            # Two segments that do not cross are nearest at an end of one of them.
            for end in range(2):
                square, _ = _square_from_origin(ax - end * ux, ay - end * uy, bx - end * ux, by - end * uy)
                if square < least:
                    least, where = square, float(end)
            for cx, cy in ((ax, ay), (bx, by)):
                square, share = _square_from_origin(-cx, -cy, ux - cx, uy - cy)
                if square < least:
                    least, where = square, share
    return math.sqrt(least), where


@inner_njit
def _farthest(path: Float64, bounds: Float64, begins: Float64, ends: Float64) -> float:
    """Upper bound of the distance of a straight path from the nearest segment.

    The distance from one segment is convex along the path: no more than the larger of those at its ends.
    """
    least = math.inf
    for group in range(len(bounds)):
        box = bounds[group]
        gap_x = max(box[0] - path[0], path[0] - box[2], 0.0)
        gap_y = max(box[1] - path[1], path[1] - box[3], 0.0)
        if gap_x * gap_x + gap_y * gap_y >= least:
            continue
        for segment in range(group * _GROUP, min((group + 1) * _GROUP, len(begins))):
            ax, ay, bx, by = begins[segment, 0], begins[segment, 1], ends[segment, 0], ends[segment, 1]
            first, _ = _square_from_origin(ax - path[0], ay - path[1], bx - path[0], by - path[1])
            last, _ = _square_from_origin(ax - path[2], ay - path[3], bx - path[2], by - path[3])
            least = min(least, max(first, last))
    return math.sqrt(least)


@compiled_above(_PLAIN_ELEMENTS)
def least_margin(
    states: Float64, corners: Float64, margins: Float64, begins: Float64, ends: Float64, tolerance: float
) -> tuple[float, int, float]:
    """Return the least signed distance of moving corners.

    The row of the step in which it occurs, and its share of the step, follow.

    Args:
        states: (T, 3) x, y and yaw, which change linearly between rows.
        corners: (C, 2) of the body, in its frame.
        margins: (T, C) signed distances at the rows.
        begins: (S, 2) of segments.
        ends: (S, 2) of segments.
        tolerance: greatest error of the distance.
    """
    bounds = _bounds(begins, ends)
    best, at_row, at_share = math.inf, 0, 0.0
    for row in range(len(margins)):
        for corner in range(len(corners)):
            if margins[row, corner] < best:
                best, at_row, at_share = margins[row, corner], row, 0.0
    path = np.empty(4)
    stack = np.empty((128, 4))
    for row in range(len(margins) - 1):
        dx, dy = states[row + 1, 0] - states[row, 0], states[row + 1, 1] - states[row, 1]
        turn = states[row + 1, 2] - states[row, 2]
        for corner in range(len(corners)):
            reach = math.hypot(corners[corner, 0], corners[corner, 1])
            length = math.hypot(dx, dy) + reach * abs(turn)
            first, last = margins[row, corner], margins[row + 1, corner]
            # The signed distance changes by no more than the way of the corner.
            if 0.5 * (first + last - length) >= best - tolerance:
                continue
            # Parts whose arcs differ from their chords by less than half of the tolerance.
            parts = max(math.ceil(abs(turn) * math.sqrt(reach / (4.0 * tolerance))), 1)
            for part in range(parts):
                begin, end = part / parts, (part + 1) / parts
                _corner_at(states, row, begin, corners[corner], path[:2])
                _corner_at(states, row, end, corners[corner], path[2:])
                if parts > 1:
                    first = _signed_distance(path[0], path[1], bounds, begins, ends)
                    last = _signed_distance(path[2], path[3], bounds, begins, ends)
                ax, ay, ux, uy = path[0], path[1], path[2] - path[0], path[3] - path[1]
                top = 0
                stack[0] = (0.0, 1.0, first, last)
                while top >= 0:
                    low, high, one, other = stack[top]
                    top -= 1
                    way = (high - low) * math.hypot(ux, uy)
                    for value, share in ((one, low), (other, high)):
                        if value < best:
                            best, at_row, at_share = value, row, begin + share * (end - begin)
                    if way < tolerance or 0.5 * (one + other - way) >= best - tolerance:
                        continue
                    path[0], path[1] = ax + low * ux, ay + low * uy
                    path[2], path[3] = ax + high * ux, ay + high * uy
                    if one > 0.0 and other > 0.0:
                        near, where = _clearance(path, bounds, begins, ends)
                        if near > 0.0:
                            if near < best:
                                share = low + where * (high - low)
                                best, at_row, at_share = near, row, begin + share * (end - begin)
                            continue
                    if -_farthest(path, bounds, begins, ends) >= best - tolerance:
                        continue
                    middle = 0.5 * (low + high)
                    value = _signed_distance(ax + middle * ux, ay + middle * uy, bounds, begins, ends)
                    stack[top + 1] = (low, middle, one, value)
                    stack[top + 2] = (middle, high, value, other)
                    top += 2
    return best, at_row, at_share


@inner_njit
def _corner_at(states: Float64, row: int, share: float, corner: Float64, out: Float64) -> None:
    rest = 1.0 - share
    yaw = rest * states[row, 2] + share * states[row + 1, 2]
    cos, sin = math.cos(yaw), math.sin(yaw)
    out[0] = rest * states[row, 0] + share * states[row + 1, 0] + cos * corner[0] - sin * corner[1]
    out[1] = rest * states[row, 1] + share * states[row + 1, 1] + sin * corner[0] + cos * corner[1]
