"""How one drives: towards one's own pace, behind somebody, up to a line.

Car following is the intelligent driver model (Treiber, Hennecke, Helbing, "Congested traffic states in empirical
observations and microscopic simulations", Phys. Rev. E 62, 2000), which brakes no harder than the closing asks for.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

from numba import njit

from mirror.arrays import Float64, Int64, UInt8
from mirror.synth.driving.ways import STEP_M

STANDSTILL_M: Final = 0.5
"""Kept to the one ahead when both stand."""
_HARDEST_MPS2: Final = 7.0
_GENTLE_MPS2: Final = 2.5

# Not called from Python: wrappers for that are a third of the time it takes to compile. (Its stubs lack the options.)
inner: Any = njit(cache=True, nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)  # type: ignore[call-overload]


class Ways(NamedTuple):
    """All ways, flat: of way w, entries ``first[w]`` to ``first[w + 1]`` of ``pace_mps``, and likewise its halts."""

    first: Int64
    pace_mps: Float64
    first_halt: Int64
    halt_m: Float64
    halt_clear_m: Float64
    halt_group: Int64
    halt_on_foot: UInt8


class Users(NamedTuple):
    """All users, a column each (N,): the recording vehicle is the first.

    Lengths along a way are those of the front end. ``enter_s`` is when a user would like to be at ``enter_m``; at
    ``pause_m`` it stands for ``pause_s``; ``end_m`` is where it leaves.
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


@inner
def pace(ways: Ways, way: int, along: float) -> float:
    """The pace of a way at a length."""
    first, last = ways.first[way], ways.first[way + 1] - 1
    place = min(max(along / STEP_M, 0.0), float(last - first))
    i = min(first + int(place), last - 1)
    f = place - (i - first)
    return ways.pace_mps[i] * (1.0 - f) + ways.pace_mps[i + 1] * f


@inner
def free(u: int, ways: Ways, road_users: Users, s: float, v: float) -> float:
    """Acceleration without anybody else: towards one's own speed, in time for bends, letting up now and then."""
    easing = 1.0 - 0.10 * (0.5 + 0.5 * math.sin(s / 17.0 + road_users.phase[u]))
    own = road_users.eager[u] * easing
    now = min(pace(ways, road_users.way[u], s) * own, road_users.fastest_mps[u])
    soon = min(pace(ways, road_users.way[u], s + 0.8 * v) * own, road_users.fastest_mps[u])
    return min(road_users.pick_up_mps2[u] * (1.0 - (v / now) ** 4), (soon - v) / 0.8)


@inner
def follow(u: int, road_users: Users, v: float, gap: float, speed: float) -> float:
    """Acceleration behind somebody at a gap who goes at a speed."""
    room = max(gap, 0.3)
    ease = 2.0 * math.sqrt(road_users.pick_up_mps2[u] * road_users.brake_mps2[u])
    wanted = STANDSTILL_M + max(0.0, v * road_users.headway_s[u] + v * (v - speed) / ease)
    # The model brakes as hard at a short gap whether or not it closes: no harder than the closing asks for.
    closing = max(v - speed, 0.0)
    hardest = min(max(1.4 * closing * closing / (2.0 * room), _GENTLE_MPS2), _HARDEST_MPS2)
    return max(road_users.pick_up_mps2[u] * (1.0 - (wanted / room) ** 2), -hardest)


@inner
def halt(u: int, road_users: Users, v: float, gap: float) -> float:
    """Acceleration towards a line to stop at."""
    return follow(u, road_users, v, gap + STANDSTILL_M, 0.0) if gap > -STANDSTILL_M else -_HARDEST_MPS2
