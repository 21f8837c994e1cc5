"""Traffic, simulated ahead of time: all follow, wait for signals and for each other, and nobody is run into.

Car following is the intelligent driver model (Treiber, Hennecke, Helbing, "Congested traffic states in empirical
observations and microscopic simulations", Phys. Rev. E 62, 2000); crossings and merges are zones that the second user
of a pair does not enter before the first has left them or goes ahead in them.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from mirror.arrays import Float64, Int64, UInt8
from mirror.synth.driving.ways import STEP_M
from mirror.synth.driving.zones import GRID_M

TICK_S: Final = 0.1
AMBER_S: Final = 3.0

_WAITING, _THERE, _GONE = 0, 1, 2
_STANDSTILL_M: Final = 0.5
_HARDEST_MPS2: Final = 7.0
_GENTLE_MPS2: Final = 2.5
_PATIENCE_S: Final = 8.0
_NEVER: Final = 1e9
_FAR: Final = 1e6
# People set off on foot only while enough of their green is left.
_LAST_CALL_S: Final = 4.0
_SIFT: Final = 10


# Never called from Python: wrappers for that would be most of the time it takes to compile them.
_inner = njit(cache=True, nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)


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


class Meetings(NamedTuple):
    """Pairs of users with a zone in common, a row each (E, 2): see `mirror.synth.driving.zones.Zone`.

    ``hold_m`` is where each waits when the other goes first; ``table`` where its limits begin within ``limits``;
    ``counts`` how many; ``major`` 0 or 1: that one of the two goes first, -1: whoever is there first.
    """

    users: Int64
    begin_m: Float64
    end_m: Float64
    hold_m: Float64
    table: Int64
    counts: Int64
    along: UInt8
    major: Int64
    limits: Float64


@njit(cache=True, nogil=True)
def signal(green_s: Float64, cycle_s: float, group: int, clock_s: float) -> int:
    """0 green, 1 amber, 2 red, 3 red and amber."""
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
    users: Users,
    meetings: Meetings,
    green_s: Float64,
    cycle_s: float,
    clock_s: float,
    ticks: int,
    heedless: bool,
) -> tuple[Float64, Float64]:
    """Let all users move.

    Args:
        ways: that they follow.
        users: who they are.
        meetings: where they are in each other's way.
        green_s: (groups, 2) of the network.
        cycle_s: of the signals.
        clock_s: of the signals, at the first tick.
        ticks: how many ticks of `TICK_S` at most; it ends earlier when the first user has left.
        heedless: the first user does not heed the others.

    Returns:
        Lengths (T, N) and speeds (T, N), NaN while a user is not there.
    """
    count = len(users.way)
    lengths = np.full((ticks, count), np.nan)
    speeds = np.full((ticks, count), np.nan)
    state = np.zeros(count, np.int64)
    s, v, a = np.zeros(count), np.zeros(count), np.zeros(count)
    wish = np.zeros(count)
    stop, stop_before = np.full(count, _FAR), np.full(count, _FAR)
    shut, shut_before = np.full(count, _FAR), np.full(count, _FAR)
    lead, lead_speed = np.full(count, _FAR), np.zeros(count)
    waited, paused = np.zeros(count), np.zeros(count)
    ahead = np.full(len(meetings.major), -1, np.int64)
    live, lives = np.empty(len(ahead), np.int64), 0
    changed = True
    done = ticks
    for tick in range(ticks):
        clock = clock_s + tick * TICK_S
        for u in range(count):
            if state[u] == _WAITING and tick * TICK_S >= users.enter_s[u]:
                speed = _entry_speed(u, ways, users, meetings, state, s, v, heedless and u == 0)
                if speed >= 0.0:
                    state[u], s[u], v[u], a[u] = _THERE, users.enter_m[u], speed, 0.0
                    changed = True
            if state[u] == _THERE:
                wish[u] = _free(u, ways, users, s[u], v[u])
                stop[u], shut[u], lead[u], lead_speed[u] = _FAR, _FAR, _FAR, 0.0
        if changed or tick % _SIFT == 0:
            lives = _alive(users, meetings, state, s, live)
            changed = False
        for n in range(lives):
            e = live[n]
            if state[meetings.users[e, 0]] == _THERE and state[meetings.users[e, 1]] == _THERE:
                _meet(e, users, meetings, ahead, s, v, wish, stop, stop_before, shut_before, lead, lead_speed, waited)
        if heedless and state[0] == _THERE:
            wish[0], stop[0], lead[0] = _free(0, ways, users, s[0], v[0]), _FAR, _FAR
        for u in range(count):
            if state[u] == _THERE:
                _wait(u, ways, users, s, v, wish, shut, lead, lead_speed, paused, green_s, cycle_s, clock)
        for u in range(count):
            if state[u] != _THERE:
                continue
            _move(u, users, s, v, a, wish, waited)
            shut_before[u] = shut[u]
            stop_before[u] = min(stop[u], shut[u])
            if lead_speed[u] < 0.3:
                stop_before[u] = min(stop_before[u], lead[u])
            lengths[tick, u], speeds[tick, u] = s[u], v[u]
            if s[u] >= users.end_m[u]:
                state[u] = _GONE
        if state[0] == _GONE:
            done = tick + 1
            break
    return lengths[:done], speeds[:done]


@_inner
def _alive(users: Users, meetings: Meetings, state: Int64, s: Float64, live: Int64) -> int:
    """Put the meetings that both have still to get through into ``live``; returns how many they are."""
    count = 0
    for e in range(len(meetings.major)):
        p, q = meetings.users[e, 0], meetings.users[e, 1]
        if state[p] != _THERE or state[q] != _THERE:
            continue
        if s[p] - users.length_m[p] > meetings.end_m[e, 0] or s[q] - users.length_m[q] > meetings.end_m[e, 1]:
            continue
        live[count] = e
        count += 1
    return count


@_inner
def _pace(ways: Ways, way: int, along: float) -> float:
    first, last = ways.first[way], ways.first[way + 1] - 1
    place = min(max(along / STEP_M, 0.0), float(last - first))
    i = min(first + int(place), last - 1)
    f = place - (i - first)
    return ways.pace_mps[i] * (1.0 - f) + ways.pace_mps[i + 1] * f


@_inner
def _free(u: int, ways: Ways, users: Users, s: float, v: float) -> float:
    """Acceleration without anybody else: towards one's own speed, in time for bends, letting up now and then."""
    easing = 1.0 - 0.10 * (0.5 + 0.5 * math.sin(s / 17.0 + users.phase[u]))
    own = users.eager[u] * easing
    now = min(_pace(ways, users.way[u], s) * own, users.fastest_mps[u])
    soon = min(_pace(ways, users.way[u], s + 0.8 * v) * own, users.fastest_mps[u])
    return min(users.pick_up_mps2[u] * (1.0 - (v / now) ** 4), (soon - v) / 0.8)


@_inner
def _follow(u: int, users: Users, v: float, gap: float, speed: float) -> float:
    """Acceleration behind somebody at a gap who goes at a speed."""
    room = max(gap, 0.3)
    ease = 2.0 * math.sqrt(users.pick_up_mps2[u] * users.brake_mps2[u])
    wanted = _STANDSTILL_M + max(0.0, v * users.headway_s[u] + v * (v - speed) / ease)
    # The model brakes as hard at a short gap whether or not it closes: no harder than the closing asks for.
    closing = max(v - speed, 0.0)
    hardest = min(max(1.4 * closing * closing / (2.0 * room), _GENTLE_MPS2), _HARDEST_MPS2)
    return max(users.pick_up_mps2[u] * (1.0 - (wanted / room) ** 2), -hardest)


@_inner
def _halt(u: int, users: Users, v: float, gap: float) -> float:
    """Acceleration towards a line to stop at."""
    return _follow(u, users, v, gap + _STANDSTILL_M, 0.0) if gap > -_STANDSTILL_M else -_HARDEST_MPS2


@_inner
def _limit(e: int, k: int, users: Users, meetings: Meetings, s: Float64) -> float:
    """How far user k of a meeting may come behind the other."""
    other = meetings.users[e, 1 - k]
    place = (s[other] - users.length_m[other] - meetings.begin_m[e, 1 - k]) / GRID_M
    first = meetings.table[e, k]
    last = meetings.counts[e, k] - 1
    if place <= 0.0:
        start = meetings.limits[first]
        return start + place * GRID_M if meetings.along[e] else start
    if place >= last:
        return meetings.limits[first + last] + (place - last) * GRID_M if meetings.along[e] else _FAR
    i = int(place)
    f = place - i
    return meetings.limits[first + i] * (1.0 - f) + meetings.limits[first + i + 1] * f


@_inner
def _entry_speed(
    u: int, ways: Ways, users: Users, meetings: Meetings, state: Int64, s: Float64, v: Float64, heedless: bool
) -> float:
    """The speed at which a user can come in, or -1 while there is no room."""
    at = users.enter_m[u]
    speed = min(_pace(ways, users.way[u], at) * users.eager[u], users.fastest_mps[u])
    if users.pause_s[u] > 0.0 and users.pause_m[u] <= at:
        speed = 0.0
    if heedless:
        return speed
    for e in range(len(meetings.major)):
        for k in range(2):
            other = meetings.users[e, 1 - k]
            if meetings.users[e, k] != u or state[other] != _THERE:
                continue
            inside = meetings.begin_m[e, k] <= at + 1.0
            if not inside or s[other] - users.length_m[other] > meetings.end_m[e, 1 - k]:
                continue
            if s[other] < meetings.begin_m[e, 1 - k]:
                continue
            gap = _limit(e, k, users, meetings, s) - at
            if gap < 3.0:
                return -1.0
            speed = min(speed, v[other] + 0.35 * (gap - 3.0))
    return speed


@_inner
def _meet(
    e: int,
    users: Users,
    meetings: Meetings,
    ahead: Int64,
    s: Float64,
    v: Float64,
    wish: Float64,
    stop: Float64,
    stop_before: Float64,
    shut_before: Float64,
    lead: Float64,
    lead_speed: Float64,
    waited: Float64,
) -> None:
    """What a meeting asks of its two users."""
    p, q = meetings.users[e, 0], meetings.users[e, 1]
    for k in range(2):
        u = meetings.users[e, k]
        if s[u] - users.length_m[u] > meetings.end_m[e, k]:
            return
    p_in, q_in = s[p] > meetings.begin_m[e, 0], s[q] > meetings.begin_m[e, 1]
    if ahead[e] >= 0 and not (p_in if ahead[e] == 0 else q_in):
        first = meetings.users[e, ahead[e]]
        if shut_before[first] < meetings.begin_m[e, ahead[e]]:
            ahead[e] = -1
    if ahead[e] < 0:
        if p_in and q_in:
            p_over = s[p] - _limit(e, 0, users, meetings, s)
            ahead[e] = 0 if p_over >= s[q] - _limit(e, 1, users, meetings, s) else 1
        elif p_in or q_in:
            ahead[e] = 0 if p_in else 1
        else:
            ahead[e] = _decide(e, users, meetings, s, v, wish, stop, stop_before, shut_before, waited)
    if ahead[e] < 0:
        return
    k = 1 - ahead[e]
    u, other = meetings.users[e, k], meetings.users[e, 1 - k]
    limit = _limit(e, k, users, meetings, s)
    if limit < s[u] - 3.0 and not meetings.along[e]:
        return
    speed = v[other] if meetings.along[e] else 0.0
    if not meetings.along[e]:
        limit = max(min(limit, meetings.hold_m[e, k]), s[u]) if s[u] < meetings.hold_m[e, k] + 0.3 else limit
    if limit - s[u] > 120.0:
        return
    wish[u] = min(wish[u], _follow(u, users, v[u], limit - s[u], speed))
    if limit < lead[u]:
        lead[u], lead_speed[u] = limit, v[other]


@_inner
def _arrival(e: int, k: int, meetings: Meetings, s: Float64, v: Float64, stop_before: Float64) -> float:
    """When user k of a meeting can be at the zone; `_FAR` if it is far away, or has to stop before it."""
    u = meetings.users[e, k]
    gap = meetings.begin_m[e, k] - s[u]
    if gap > 90.0 or stop_before[u] < meetings.begin_m[e, k] - 0.2:
        return _FAR
    return gap / max(v[u] + 0.7, 0.8)


@_inner
def _decide(
    e: int,
    users: Users,
    meetings: Meetings,
    s: Float64,
    v: Float64,
    wish: Float64,
    stop: Float64,
    stop_before: Float64,
    shut_before: Float64,
    waited: Float64,
) -> int:
    """Who goes first (0 or 1) when neither is in the zone yet; -1: it is left open."""
    major = meetings.major[e]
    if major < 0:
        t0 = _arrival(e, 0, meetings, s, v, stop_before)
        t1 = _arrival(e, 1, meetings, s, v, stop_before)
        if min(t0, t1) >= _FAR:
            return -1
        major = 0 if t0 <= t1 else 1
        if meetings.along[e] and max(t0, t1) < 6.0:
            return major
    minor = 1 - major
    m, M = meetings.users[e, minor], meetings.users[e, major]
    to_hold = meetings.hold_m[e, minor] - s[m]
    if to_hold > 60.0 or shut_before[m] < meetings.begin_m[e, minor]:
        return -1
    arrives = _arrival(e, major, meetings, s, v, stop_before)
    way_out = (meetings.begin_m[e, minor] + 1.0 if meetings.along[e] else meetings.end_m[e, minor]) - s[m]
    way_out += users.length_m[m]
    quick = 0.8 * users.pick_up_mps2[m]
    reached = min(users.fastest_mps[m], max(v[m], 5.0))
    clears = (-v[m] + math.sqrt(v[m] * v[m] + 2.0 * quick * way_out)) / quick
    clears = max(clears, way_out / reached)
    margin = 1.2 if waited[m] < _PATIENCE_S else 0.4
    if meetings.along[e]:
        margin += 0.25 * max(v[M] - v[m], 0.0)
    accepts = arrives > clears + margin
    cannot_stop = v[m] * v[m] > 2.0 * 4.5 * max(to_hold, 0.05) and v[m] > 1.0
    near = to_hold < v[m] * v[m] / (2.0 * 2.0) + 1.0
    if cannot_stop or (accepts and near):
        return minor
    if not accepts:
        wish[m] = min(wish[m], _halt(m, users, v[m], to_hold))
        stop[m] = min(stop[m], meetings.hold_m[e, minor])
    return -1


@_inner
def _wait(
    u: int,
    ways: Ways,
    users: Users,
    s: Float64,
    v: Float64,
    wish: Float64,
    shut: Float64,
    lead: Float64,
    lead_speed: Float64,
    paused: Float64,
    green_s: Float64,
    cycle_s: float,
    clock: float,
) -> None:
    """What signals, crossings that are full, and own pauses ask of a user."""
    if users.pause_s[u] > paused[u]:
        gap = users.pause_m[u] - s[u]
        if gap < 80.0:
            wish[u] = min(wish[u], _halt(u, users, v[u], gap))
            shut[u] = min(shut[u], users.pause_m[u])
        if v[u] < 0.05 and gap < 1.5:
            paused[u] += TICK_S
    way = users.way[u]
    for h in range(ways.first_halt[way], ways.first_halt[way + 1]):
        gap = ways.halt_m[h] - s[u]
        if gap < -0.3 or gap > 90.0:
            continue
        closed = False
        if ways.halt_group[h] >= 0:
            light = signal(green_s, cycle_s, ways.halt_group[h], clock)
            if ways.halt_on_foot[h]:
                closed = light != 0 or signal(green_s, cycle_s, ways.halt_group[h], clock + _LAST_CALL_S) != 0
            else:
                closed = light != 0
            if light == 1 and v[u] * v[u] > 2.0 * 3.2 * max(gap, 0.1):
                closed = False
        full = lead[u] < ways.halt_clear_m[h] + users.length_m[u] + 0.5 and lead_speed[u] < 1.5
        if not closed and full and lead[u] > ways.halt_m[h] and not ways.halt_on_foot[h]:
            closed = v[u] * v[u] < 2.0 * 3.0 * max(gap, 0.1)
        if closed:
            wish[u] = min(wish[u], _halt(u, users, v[u], gap))
            shut[u] = min(shut[u], ways.halt_m[h])


@_inner
def _move(u: int, users: Users, s: Float64, v: Float64, a: Float64, wish: Float64, waited: Float64) -> None:
    """One tick: the acceleration changes gradually, the speed never turns round."""
    a_new = min(max(wish[u], a[u] - 12.0 * TICK_S), a[u] + 4.0 * TICK_S)
    v_new = v[u] + 0.5 * (a[u] + a_new) * TICK_S
    if v_new <= 0.0:
        s[u] += 0.5 * v[u] * TICK_S
        v[u], a[u] = 0.0, 0.0
    else:
        s[u] += TICK_S * (v[u] + TICK_S * (2.0 * a[u] + a_new) / 6.0)
        v[u], a[u] = v_new, a_new
    waited[u] = waited[u] + TICK_S if v[u] < 0.2 else 0.0
