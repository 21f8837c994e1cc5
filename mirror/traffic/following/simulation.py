"""The traffic simulation: all road users follow their ways, obey signals, yield to each other, and do not collide."""

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float64, Int64
from mirror.compiled import inner_njit
from mirror.traffic.following.acceleration import (
    Users,
    Ways,
    advance_along,
    free_acceleration,
    pace_at,
    stopping_acceleration,
)
from mirror.traffic.following.yielding import FAR, Meetings, State, limit_position, yield_at_meeting

TICK_S: Final = 0.1
AMBER_S: Final = 3.0

_WAITING, _PRESENT, _GONE = 0, 1, 2
# Pedestrians start to cross only if at least this much of the green is left.
_LAST_CALL_S: Final = 4.0
_SIFT: Final = 10


@njit(cache=True, nogil=True)
def signal_at(green_s: Float64, cycle_s: float, group: int, clock_s: float) -> int:
    """Return the state of a signal group: 0 green, 1 amber, 2 red, 3 red and amber."""
    since = (clock_s - green_s[group, 0]) % cycle_s
    green = green_s[group, 1] - green_s[group, 0]
    if since < green:
        return 0
    if since < green + AMBER_S:
        return 1
    return 3 if since > cycle_s - 1.0 else 2


@njit(cache=True, nogil=True)
def simulate(
    ways: Ways,
    road_users: Users,
    meetings: Meetings,
    now: State,
    green_s: Float64,
    cycle_s: float,
    clock_s: float,
    ticks: int,
    heedless: bool,
) -> tuple[Float64, Float64]:
    """Simulate all road users.

    Args:
        ways: ways of the road users.
        road_users: the road users.
        meetings: pairs of road users with conflicting ways.
        now: state of the road users, initially 0; modified.
        green_s: (groups, 2) start and end of green in the cycle, of the network.
        cycle_s: length of the signal cycle.
        clock_s: time of the signal cycle at the first tick.
        ticks: largest number of ticks of `TICK_S`; the simulation ends when the first user has left.
        heedless: whether the first user ignores the others.

    Returns:
        Lengths (T, N) along the ways and speeds (T, N); NaN while a user is absent.
    """
    count = len(road_users.way)
    lengths = np.full((ticks, count), np.nan)
    speeds = np.full((ticks, count), np.nan)
    presence = np.full(count, _WAITING)
    ahead = np.full(len(meetings.major), -1, np.int64)
    live, lives = np.empty(len(ahead), np.int64), 0
    change_lane_pieces = True
    ticks_used = ticks
    for tick in range(ticks):
        clock = clock_s + tick * TICK_S
        for u in range(count):
            if presence[u] == _WAITING and tick * TICK_S >= road_users.enter_s[u]:
                speed = _entry_speed(u, ways, road_users, meetings, presence, now, heedless and u == 0)
                if speed >= 0.0:
                    presence[u], now.s[u], now.v[u] = _PRESENT, road_users.enter_m[u], speed
                    now.stop_before[u] = now.shut_before[u] = FAR
                    change_lane_pieces = True
            if presence[u] == _PRESENT:
                now.wish[u] = free_acceleration(u, ways, road_users, now.s[u], now.v[u])
                now.stop[u], now.shut[u], now.lead[u], now.lead_speed[u] = FAR, FAR, FAR, 0.0
        if change_lane_pieces or tick % _SIFT == 0:
            lives = _is_active(road_users, meetings, presence, now.s, live)
            change_lane_pieces = False
        for e in live[:lives]:
            if presence[meetings.road_users[e, 0]] == _PRESENT and presence[meetings.road_users[e, 1]] == _PRESENT:
                yield_at_meeting(e, road_users, meetings, ahead, now)
        if heedless and presence[0] == _PRESENT:
            now.wish[0], now.stop[0], now.lead[0] = free_acceleration(0, ways, road_users, now.s[0], now.v[0]), FAR, FAR
        for u in range(count):
            if presence[u] == _PRESENT:
                _wait_at_halt(u, ways, road_users, now, green_s, cycle_s, clock)
                _advance(u, now)
                lengths[tick, u], speeds[tick, u] = now.s[u], now.v[u]
                if now.s[u] >= road_users.end_m[u]:
                    presence[u] = _GONE
        if presence[0] == _GONE:
            ticks_used = tick + 1
            break
    return lengths[:ticks_used], speeds[:ticks_used]


@inner_njit
def _is_active(road_users: Users, meetings: Meetings, presence: Int64, s: Float64, live: Int64) -> int:
    """Write the meetings that are not over yet to ``live``; returns their number."""
    count = 0
    for e in range(len(meetings.major)):
        p, q = meetings.road_users[e, 0], meetings.road_users[e, 1]
        if presence[p] != _PRESENT or presence[q] != _PRESENT:
            continue
        if s[p] - road_users.length_m[p] > meetings.end_m[e, 0] or s[q] - road_users.length_m[q] > meetings.end_m[e, 1]:
            continue
        live[count] = e
        count += 1
    return count


@inner_njit
def _entry_speed(
    u: int, ways: Ways, road_users: Users, meetings: Meetings, presence: Int64, now: State, heedless: bool
) -> float:
    """Speed at which a user can enter; -1 while there is no room."""
    at = road_users.enter_m[u]
    speed = min(pace_at(ways, road_users.way[u], at) * road_users.eager[u], road_users.fastest_mps[u])
    if road_users.pause_s[u] > 0.0 and road_users.pause_m[u] <= at:
        speed = 0.0
    if heedless:
        return speed
    for e in range(len(meetings.major)):
        for k in range(2):
            other = meetings.road_users[e, 1 - k]
            if meetings.road_users[e, k] != u or presence[other] != _PRESENT:
                continue
            inside = meetings.begin_m[e, k] <= at + 1.0
            if not inside or now.s[other] - road_users.length_m[other] > meetings.end_m[e, 1 - k]:
                continue
            if now.s[other] < meetings.begin_m[e, 1 - k]:
                continue
            gap = limit_position(e, k, road_users, meetings, now.s) - at
            if gap < 3.0:
                return -1.0
            speed = min(speed, now.v[other] + 0.35 * (gap - 3.0))
    return speed


@inner_njit
def _wait_at_halt(
    u: int, ways: Ways, road_users: Users, now: State, green_s: Float64, cycle_s: float, clock: float
) -> None:
    """Apply signals, occupied crossings and pauses to a user."""
    if road_users.pause_s[u] > now.paused[u]:
        gap = road_users.pause_m[u] - now.s[u]
        if gap < 80.0:
            now.wish[u] = min(now.wish[u], stopping_acceleration(u, road_users, now.v[u], gap))
            now.shut[u] = min(now.shut[u], road_users.pause_m[u])
        if now.v[u] < 0.05 and gap < 1.5:
            now.paused[u] += TICK_S
    way = road_users.way[u]
    for h in range(ways.first_halt[way], ways.first_halt[way + 1]):
        gap = ways.halt_m[h] - now.s[u]
        if gap < -0.3 or gap > 90.0:
            continue
        closed = False
        if ways.halt_group[h] >= 0:
            light = signal_at(green_s, cycle_s, ways.halt_group[h], clock)
            if ways.halt_on_foot[h]:
                closed = light != 0 or signal_at(green_s, cycle_s, ways.halt_group[h], clock + _LAST_CALL_S) != 0
            else:
                closed = light != 0
            if light == 1 and now.v[u] * now.v[u] > 2.0 * 3.2 * max(gap, 0.1):
                closed = False
        full = now.lead[u] < ways.halt_clear_m[h] + road_users.length_m[u] + 0.5 and now.lead_speed[u] < 1.5
        if not closed and full and now.lead[u] > ways.halt_m[h] and not ways.halt_on_foot[h]:
            closed = now.v[u] * now.v[u] < 2.0 * 3.0 * max(gap, 0.1)
        if closed:
            now.wish[u] = min(now.wish[u], stopping_acceleration(u, road_users, now.v[u], gap))
            now.shut[u] = min(now.shut[u], ways.halt_m[h])


@inner_njit
def _advance(u: int, now: State) -> None:
    """Advance a user by one tick."""
    now.s[u], now.v[u], now.a[u] = advance_along(now.s[u], now.v[u], now.a[u], now.wish[u], TICK_S)
    now.waited[u] = now.waited[u] + TICK_S if now.v[u] < 0.2 else 0.0
    now.shut_before[u] = now.shut[u]
    now.stop_before[u] = min(now.stop[u], now.shut[u])
    if now.lead_speed[u] < 0.3:
        now.stop_before[u] = min(now.stop_before[u], now.lead[u])
