"""Compiled geometry of two rectangles seen from above: their gap, and when they touch at constant velocities."""

from __future__ import annotations

import math
from typing import Final

from mirror.compiled import compiled_above, inner_njit

NEVER = math.inf


PLAIN_ELEMENTS: Final = 10_000
"""Elements of arrays below which figures of road users are computed as plain Python: ten seconds among twenty."""


@compiled_above(PLAIN_ELEMENTS)
def signed_gap(
    dx: float, dy: float, yaw_a: float, yaw_b: float, length_a: float, width_a: float, length_b: float, width_b: float
) -> float:
    """Return the largest separation of two rectangles along the axes of either (separating axis theorem).

    Positive: the rectangles are apart, and their distance is at least this. Zero or negative: they touch or overlap.

    Args:
        dx: x of the second centre from the first.
        dy: y of the second centre from the first.
        yaw_a: heading of the first.
        yaw_b: heading of the second.
        length_a: half the length of the first.
        width_a: half the width of the first.
        length_b: half the length of the second.
        width_b: half the width of the second.
    """
    ca, sa, cb, sb = math.cos(yaw_a), math.sin(yaw_a), math.cos(yaw_b), math.sin(yaw_b)
    cos, sin = abs(ca * cb + sa * sb), abs(ca * sb - sa * cb)
    gap = abs(dx * ca + dy * sa) - (length_a + length_b * cos + width_b * sin)
    gap = max(gap, abs(dy * ca - dx * sa) - (width_a + length_b * sin + width_b * cos))
    gap = max(gap, abs(dx * cb + dy * sb) - (length_b + length_a * cos + width_a * sin))
    return max(gap, abs(dy * cb - dx * sb) - (width_b + length_a * sin + width_a * cos))


@inner_njit
def _clip(offset: float, speed: float, reach: float, enter: float, leave: float) -> tuple[float, float]:
    """Cut the interval [enter, leave] to the times at which |offset + speed * t| <= reach."""
    if speed == 0.0:
        return (enter, leave) if abs(offset) <= reach else (math.inf, -math.inf)
    first, last = (-reach - offset) / speed, (reach - offset) / speed
    if first > last:
        first, last = last, first
    return max(enter, first), min(leave, last)


@inner_njit
def contact_time(
    dx: float,
    dy: float,
    vx: float,
    vy: float,
    yaw_a: float,
    yaw_b: float,
    length_a: float,
    width_a: float,
    length_b: float,
    width_b: float,
) -> float:
    """Return the time in [0, inf] until two rectangles that move without turning touch; 0: now, inf: never.

    It is exact: two convex polygons that do not turn overlap while their shadows overlap on each axis of either.

    Args:
        dx: x of the second centre from the first.
        dy: y of the second centre from the first.
        vx: velocity along x of the second relative to the first.
        vy: velocity along y of the second relative to the first.
        yaw_a: heading of the first.
        yaw_b: heading of the second.
        length_a: half the length of the first.
        width_a: half the width of the first.
        length_b: half the length of the second.
        width_b: half the width of the second.
    """
    ca, sa, cb, sb = math.cos(yaw_a), math.sin(yaw_a), math.cos(yaw_b), math.sin(yaw_b)
    cos, sin = abs(ca * cb + sa * sb), abs(ca * sb - sa * cb)
    enter, leave = 0.0, math.inf
    reach = length_a + length_b * cos + width_b * sin
    enter, leave = _clip(dx * ca + dy * sa, vx * ca + vy * sa, reach, enter, leave)
    reach = width_a + length_b * sin + width_b * cos
    enter, leave = _clip(dy * ca - dx * sa, vy * ca - vx * sa, reach, enter, leave)
    reach = length_b + length_a * cos + width_a * sin
    enter, leave = _clip(dx * cb + dy * sb, vx * cb + vy * sb, reach, enter, leave)
    reach = width_b + length_a * sin + width_a * cos
    enter, leave = _clip(dy * cb - dx * sb, vy * cb - vx * sb, reach, enter, leave)
    return enter if enter <= leave else math.inf
