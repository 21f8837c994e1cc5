"""Compiled perception of agents on ways: who is ahead in the corridor of a way, and what acceleration follows."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.compiled import compiled_above
from mirror.traffic.following.acceleration import (
    Users,
    Ways,
    advance_along,
    following_acceleration,
    free_acceleration,
    stopping_acceleration,
)
from mirror.traffic.lanes.ways import STEP_M

_SIDE_MARGIN_M: Final = 0.15
_LEAST_SIGHT_M: Final = 15.0
_SIGHT_S: Final = 7.0
_STRIDE: Final = 2
_PLAIN_ELEMENTS: Final = 400_000
"""Elements of arrays below which agents look ahead as plain Python: some two hundred steps."""


@compiled_above(_PLAIN_ELEMENTS)
def place_on_way(
    points: Float64, first: int, last: int, low_m: float, high_m: float, x: float, y: float
) -> tuple[float, float, float, bool]:
    """Find the place on a way that is nearest to a point.

    Its length along the way, offset to the left and direction are returned, and whether it is inside.

    Args:
        points: (P, 2) points of all ways, every `STEP_M`.
        first: index of the way's first point.
        last: index of its last point.
        low_m: length at which the search begins.
        high_m: length at which it ends.
        x: position of the point.
        y: position of the point.
    """
    begin = first + max(int(low_m / STEP_M), 0)
    end = min(first + int(high_m / STEP_M) + 1, last)
    if end <= begin:
        return 0.0, 0.0, 0.0, False
    best, nearest = math.inf, begin
    for index in range(begin, end + 1, _STRIDE):
        dx, dy = points[index, 0] - x, points[index, 1] - y
        square = dx * dx + dy * dy
        if square < best:
            best, nearest = square, index
    for index in range(max(nearest - _STRIDE + 1, begin), min(nearest + _STRIDE, end + 1)):
        dx, dy = points[index, 0] - x, points[index, 1] - y
        square = dx * dx + dy * dy
        if square < best:
            best, nearest = square, index
    low, high = max(nearest - 1, first), min(nearest + 1, last)
    heading = math.atan2(points[high, 1] - points[low, 1], points[high, 0] - points[low, 0])
    cos, sin = math.cos(heading), math.sin(heading)
    dx, dy = x - points[nearest, 0], y - points[nearest, 1]
    along = STEP_M * (nearest - first) + cos * dx + sin * dy
    inside = begin < nearest < end or abs(cos * dx + sin * dy) < STEP_M
    return along, cos * dy - sin * dx, heading, inside


@compiled_above(_PLAIN_ELEMENTS)
def gap_on_way(
    points: Float64,
    first: int,
    last: int,
    front_m: float,
    length_m: float,
    aside_m: float,
    half_width_m: float,
    sight_m: float,
    box: Float64,
) -> tuple[float, float]:
    """Return the gap from a user of a way to a box ahead, and the box's speed along the way.

    The result is (inf, 0) if the box is not in the corridor.

    Args:
        points: (P, 2) points of all ways.
        first: index of the way's first point.
        last: index of its last point.
        front_m: length of the user's front end along the way.
        length_m: length of the user.
        aside_m: offset of the user to the left of the way.
        half_width_m: half of the user's width.
        sight_m: how far ahead the user looks.
        box: (7,) x, y, yaw, forward speed, half length, half width, presence.
    """  # fmt: skip
    along, side, heading, inside = place_on_way(
        points, first, last, front_m - length_m, front_m + sight_m, box[0], box[1]
    )
    if not inside:
        return math.inf, 0.0
    turned = box[2] - heading
    cos, sin = abs(math.cos(turned)), abs(math.sin(turned))
    half_along = cos * box[4] + sin * box[5]
    half_across = sin * box[4] + cos * box[5]
    if along < front_m - 0.5 * length_m or abs(side - aside_m) > half_width_m + half_across + _SIDE_MARGIN_M:
        return math.inf, 0.0
    return along - half_along - front_m, box[3] * math.cos(turned)


@compiled_above(_PLAIN_ELEMENTS)
def follow(
    ways: Ways,
    points: Float64,
    road_users: Users,
    half_width_m: Float64,
    state: Float64,
    own: Int64,
    boxes: Float64,
    closed: Int64,
    ordered_mps2: Float64,
    step_s: float,
) -> Float64:
    """Advance all users of ways by a step; all read the boxes of the same instant, so their order is irrelevant.

    Args:
        ways: the ways.
        points: (P, 2) their points.
        road_users: N users.
        half_width_m: (N,) half of their widths.
        state: (N, 5) length of the front end, speed, acceleration, offset to the left and its rate.
        own: (N,) row of each user in ``boxes``.
        boxes: (M, 7) boxes of all actors.
        closed: (H,) 1 where a halt of ``ways`` is closed.
        ordered_mps2: (N,) acceleration that a script orders; NaN: the user decides.
        step_s: duration of the step.

    Returns:
        (N, 5) the new state.
    """  # fmt: skip
    new = state.copy()
    for u in range(len(state)):
        s, v, a, aside = state[u, 0], state[u, 1], state[u, 2], state[u, 3]
        way = road_users.way[u]
        first, last = ways.first[way], ways.first[way + 1] - 1
        wish = free_acceleration(u, ways, road_users, s, v)
        sight = _LEAST_SIGHT_M + _SIGHT_S * v
        x, y = boxes[own[u], 0], boxes[own[u], 1]
        for j in range(len(boxes)):
            if j == own[u] or boxes[j, 6] == 0.0:
                continue
            reach = sight + road_users.length_m[u] + boxes[j, 4]
            if abs(boxes[j, 0] - x) > reach or abs(boxes[j, 1] - y) > reach:
                continue
            gap, speed = gap_on_way(
                points, first, last, s, road_users.length_m[u], aside, half_width_m[u], sight, boxes[j]
            )
            if gap < sight:
                wish = min(wish, following_acceleration(u, road_users, v, gap, speed))
        for h in range(ways.first_halt[way], ways.first_halt[way + 1]):
            gap = ways.halt_m[h] - s
            if closed[h] and -0.3 < gap < 90.0:
                wish = min(wish, stopping_acceleration(u, road_users, v, gap))
        if not math.isnan(ordered_mps2[u]):
            wish = ordered_mps2[u]
        new[u, 0], new[u, 1], new[u, 2] = advance_along(s, v, a, wish, step_s)
    return new


@compiled_above(_PLAIN_ELEMENTS)
def poses_on_ways(
    points: Float64, first: Int64, way: Int64, length_m: Float64, state: Float64
) -> tuple[Float64, Float64]:
    """Return the poses (N, 3) of the middles of users of ways, and velocities (N, 2).

    The axles, 0.3 lengths before and behind the middle, are on the line, which continues straight beyond its ends.

    Args:
        points: (P, 2) points of all ways.
        first: index of each way's first point, and one more.
        way: (N,) way of each user.
        length_m: (N,) lengths.
        state: (N, 5) as `follow` takes it.
    """
    poses, velocities = np.empty((len(state), 3)), np.empty((len(state), 2))
    for u in range(len(state)):
        begin, end = first[way[u]], first[way[u] + 1] - 1
        middle = state[u, 0] - 0.5 * length_m[u]
        x_front, y_front = _point_at(points, begin, end, middle + 0.3 * length_m[u])
        x_rear, y_rear = _point_at(points, begin, end, middle - 0.3 * length_m[u])
        heading = math.atan2(y_front - y_rear, x_front - x_rear)
        cos, sin = math.cos(heading), math.sin(heading)
        poses[u, 0] = 0.5 * (x_front + x_rear) - state[u, 3] * sin
        poses[u, 1] = 0.5 * (y_front + y_rear) + state[u, 3] * cos
        velocities[u, 0] = state[u, 1] * cos - state[u, 4] * sin
        velocities[u, 1] = state[u, 1] * sin + state[u, 4] * cos
        poses[u, 2] = heading + (math.atan2(state[u, 4], state[u, 1]) if state[u, 1] > 0.5 else 0.0)
    return poses, velocities


@compiled_above(_PLAIN_ELEMENTS)
def _point_at(points: Float64, first: int, last: int, along: float) -> tuple[float, float]:
    place = along / STEP_M
    index = min(max(math.floor(place), 0), last - first - 1) + first
    f = place - (index - first)
    x = points[index, 0] + f * (points[index + 1, 0] - points[index, 0])
    y = points[index, 1] + f * (points[index + 1, 1] - points[index, 1])
    return x, y
