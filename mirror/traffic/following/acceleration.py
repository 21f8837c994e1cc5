"""Longitudinal driving: acceleration on a free road, behind another road user, and towards a stop line.

Car following uses the intelligent driver model (Treiber, Hennecke, Helbing, "Congested traffic states in empirical
observations and microscopic simulations", Phys. Rev. E 62, 2000) with a limit on braking.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from mirror.arrays import Float64, Int64, UInt8
from mirror.compiled import inner_njit
from mirror.portable import scalars
from mirror.traffic.lanes.ways import STEP_M

STANDSTILL_M: Final = 0.5
"""Gap to the road user ahead when both stand."""
_HARDEST_MPS2: Final = 7.0
_GENTLE_MPS2: Final = 2.5


class Ways(NamedTuple):
    """All ways, flat: entries ``first[w]`` to ``first[w + 1]`` of ``pace_mps`` belong to way w; likewise for halts."""

    first: Int64
    pace_mps: Float64
    first_halt: Int64
    halt_m: Float64
    halt_clear_m: Float64
    halt_group: Int64
    halt_on_foot: UInt8


class Users(NamedTuple):
    """All road users, as arrays (N,); the first is the recording vehicle.

    Lengths along a way refer to the front end. A user wants to be at ``enter_m`` at ``enter_s``, stands at ``pause_m``
    for ``pause_s``, and leaves at ``end_m``.
    """

    way: Int64
    length_m: Float64
    enter_s: Float64
    enter_m: Float64
    end_m: Float64
    eager: Float64
    fastest_mps: Float64
    pick_up_mps2: Float64
    brake_mps2: Float64
    headway_s: Float64
    phase: Float64
    pause_m: Float64
    pause_s: Float64


@inner_njit
def pace_at(ways: Ways, way: int, along: float) -> float:
    """Return the speed that a way allows at a length along the way."""
    first, last = ways.first[way], ways.first[way + 1] - 1
    place = min(max(along / STEP_M, 0.0), float(last - first))
    i = min(first + int(place), last - 1)
    f = place - (i - first)
    return ways.pace_mps[i] * (1.0 - f) + ways.pace_mps[i + 1] * f


@inner_njit
def free_acceleration(u: int, ways: Ways, road_users: Users, s: float, v: float) -> float:
    """Return the acceleration towards the desired speed on a free road.

    The desired speed is lower before bends and varies a little.
    """
    easing = 1.0 - 0.10 * (0.5 + 0.5 * scalars.sin(s / 17.0 + road_users.phase[u]))
    free = road_users.eager[u] * easing
    now = min(pace_at(ways, road_users.way[u], s) * free, road_users.fastest_mps[u])
    soon = min(pace_at(ways, road_users.way[u], s + 0.8 * v) * free, road_users.fastest_mps[u])
    share = v / now
    share *= share
    return min(road_users.pick_up_mps2[u] * (1.0 - share * share), (soon - v) / 0.8)


@inner_njit
def following_acceleration(u: int, road_users: Users, v: float, gap: float, speed: float) -> float:
    """Return the acceleration behind a road user at a gap, metres, and a speed, m/s."""
    room = max(gap, 0.3)
    ease = 2.0 * math.sqrt(road_users.pick_up_mps2[u] * road_users.brake_mps2[u])
    desired_gap = STANDSTILL_M + max(0.0, v * road_users.headway_s[u] + v * (v - speed) / ease)
    # The model brakes hard at a short gap even if the gap does not close; the limit prevents that.
    closing = max(v - speed, 0.0)
    hardest = min(max(1.4 * closing * closing / (2.0 * room), _GENTLE_MPS2), _HARDEST_MPS2)
    share = desired_gap / room
    return max(road_users.pick_up_mps2[u] * (1.0 - share * share), -hardest)


@inner_njit
def stopping_acceleration(u: int, road_users: Users, v: float, gap: float) -> float:
    """Return the acceleration towards a stop line."""
    return following_acceleration(u, road_users, v, gap + STANDSTILL_M, 0.0) if gap > -STANDSTILL_M else -_HARDEST_MPS2


@inner_njit
def advance_along(s: float, v: float, a: float, wish: float, tick_s: float) -> tuple[float, float, float]:
    """Return the length, speed and acceleration after one tick of the simulation.

    The acceleration changes gradually, the speed is never negative.
    """
    a_new = min(max(wish, a - 12.0 * tick_s), a + 4.0 * tick_s)
    v_new = v + 0.5 * (a + a_new) * tick_s
    if v_new <= 0.0:
        return s + 0.5 * v * tick_s, 0.0, 0.0
    return s + tick_s * (v + tick_s * (2.0 * a + a_new) / 6.0), v_new, a_new
