"""Right of way in zones where ways meet: the second road user waits until the first has left, or follows it."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from mirror.arrays import Float64, Int64, UInt8
from mirror.compiled import inner_njit
from mirror.traffic.following.acceleration import Users, following_acceleration, stopping_acceleration
from mirror.traffic.following.zones import GRID_M

FAR: Final = 1e6
"""A distance or time beyond any that matters, metres or seconds."""
_PATIENCE_S: Final = 8.0
_YIELDS_S: Final = 5.0


class State(NamedTuple):
    """The state of all users, as arrays (N,), in the order of the fields.

    Length along the way, speed and acceleration; desired acceleration; stopping position because of right of way, now
    and at the previous tick; stopping position because of a signal, a pause or an occupied crossing; limit position
    behind another user, and the speed of that user; stopping position at the previous tick for any reason; time for
    which the user has stood; elapsed time of the pause.
    """

    s: Float64
    v: Float64
    a: Float64
    wish: Float64
    stop: Float64
    shut: Float64
    shut_before: Float64
    lead: Float64
    lead_speed: Float64
    stop_before: Float64
    waited: Float64
    paused: Float64


class Meetings(NamedTuple):
    """Pairs of users with a common zone, as arrays (E, 2): see `mirror.traffic.following.zones.Zone`.

    ``hold_m`` is the position where each user waits if the other goes first; ``table`` and ``counts`` give the first
    index and the number of its entries in ``limits``; ``major`` is the user with right of way (0 or 1), or -1 if the
    user that arrives first has it.
    """

    road_users: Int64
    begin_m: Float64
    end_m: Float64
    hold_m: Float64
    table: Int64
    counts: Int64
    along: UInt8
    major: Int64
    limits: Float64


@inner_njit
def limit_position(e: int, k: int, road_users: Users, meetings: Meetings, s: Float64) -> float:
    """Return the position up to which user k of a meeting may advance behind the other."""
    other = meetings.road_users[e, 1 - k]
    place = (s[other] - road_users.length_m[other] - meetings.begin_m[e, 1 - k]) / GRID_M
    first = meetings.table[e, k]
    last = meetings.counts[e, k] - 1
    if place <= 0.0:
        start = meetings.limits[first]
        return start + place * GRID_M if meetings.along[e] else start
    if place >= last:
        return meetings.limits[first + last] + (place - last) * GRID_M if meetings.along[e] else FAR
    i = int(place)
    f = place - i
    return meetings.limits[first + i] * (1.0 - f) + meetings.limits[first + i + 1] * f


@inner_njit
def yield_at_meeting(e: int, road_users: Users, meetings: Meetings, ahead: Int64, now: State) -> None:
    """Apply a meeting to its two users."""
    p, q = meetings.road_users[e, 0], meetings.road_users[e, 1]
    for k in range(2):
        u = meetings.road_users[e, k]
        if now.s[u] - road_users.length_m[u] > meetings.end_m[e, k]:
            return
    p_in, q_in = now.s[p] > meetings.begin_m[e, 0], now.s[q] > meetings.begin_m[e, 1]
    if ahead[e] >= 0 and not (p_in if ahead[e] == 0 else q_in):
        first = meetings.road_users[e, ahead[e]]
        if now.shut_before[first] < meetings.begin_m[e, ahead[e]]:
            ahead[e] = -1
    if p_in and q_in and (ahead[e] < 0 or meetings.along[e]):
        # If one user is behind the other, the one in front goes first, regardless of earlier decisions.
        p_over = now.s[p] - limit_position(e, 0, road_users, meetings, now.s)
        ahead[e] = 0 if p_over >= now.s[q] - limit_position(e, 1, road_users, meetings, now.s) else 1
    if ahead[e] < 0:
        if p_in or q_in:
            ahead[e] = 0 if p_in else 1
        else:
            ahead[e] = _decide(e, road_users, meetings, now)
    if ahead[e] < 0:
        return
    k = 1 - ahead[e]
    u, other = meetings.road_users[e, k], meetings.road_users[e, 1 - k]
    upto = limit_position(e, k, road_users, meetings, now.s)
    if upto < now.s[u] - 3.0 and not meetings.along[e]:
        return
    speed = now.v[other] if meetings.along[e] else 0.0
    if not meetings.along[e]:
        upto = max(min(upto, meetings.hold_m[e, k]), now.s[u]) if now.s[u] < meetings.hold_m[e, k] + 0.3 else upto
    if upto - now.s[u] > 120.0:
        return
    now.wish[u] = min(now.wish[u], following_acceleration(u, road_users, now.v[u], upto - now.s[u], speed))
    if upto < now.lead[u]:
        now.lead[u], now.lead_speed[u] = upto, now.v[other]


@inner_njit
def _arrival(e: int, k: int, meetings: Meetings, now: State) -> float:
    """Earliest arrival of user k at the zone; `FAR` if it is far away, has to stop before the zone, or stands."""
    u = meetings.road_users[e, k]
    gap = meetings.begin_m[e, k] - now.s[u]
    if gap > 90.0 or now.stop_before[u] < meetings.begin_m[e, k] - 0.2 or now.waited[u] > _YIELDS_S:
        return FAR
    return gap / max(now.v[u] + 0.7, 0.8)


@inner_njit
def _decide(e: int, road_users: Users, meetings: Meetings, now: State) -> int:
    """Decide which user goes first (0 or 1) while neither is in the zone; -1: undecided."""
    major = meetings.major[e]
    if major < 0:
        t0 = _arrival(e, 0, meetings, now)
        t1 = _arrival(e, 1, meetings, now)
        if min(t0, t1) >= FAR:
            return -1
        major = 0 if t0 <= t1 else 1
        if meetings.along[e] and max(t0, t1) < 6.0:
            return major
    minor = 1 - major
    m, M = meetings.road_users[e, minor], meetings.road_users[e, major]
    to_hold = meetings.hold_m[e, minor] - now.s[m]
    if to_hold > 60.0 or now.shut_before[m] < meetings.begin_m[e, minor]:
        return -1
    arrives = _arrival(e, major, meetings, now)
    way_out = (meetings.begin_m[e, minor] + 1.0 if meetings.along[e] else meetings.end_m[e, minor]) - now.s[m]
    way_out += road_users.length_m[m]
    quick = 0.8 * road_users.pick_up_mps2[m]
    reached = min(road_users.fastest_mps[m], max(now.v[m], 5.0))
    clears = (-now.v[m] + math.sqrt(now.v[m] * now.v[m] + 2.0 * quick * way_out)) / quick
    clears = max(clears, way_out / reached)
    margin = 1.2 if now.waited[m] < _PATIENCE_S else 0.4
    if meetings.along[e]:
        margin += 0.25 * max(now.v[M] - now.v[m], 0.0)
    accepts = arrives > clears + margin
    cannot_stop = now.v[m] * now.v[m] > 2.0 * 4.5 * max(to_hold, 0.05) and now.v[m] > 1.0
    near = to_hold < now.v[m] * now.v[m] / (2.0 * 2.0) + 1.0
    if cannot_stop or (accepts and near):
        return minor
    if not accepts:
        now.wish[m] = min(now.wish[m], stopping_acceleration(m, road_users, now.v[m], to_hold))
        now.stop[m] = min(now.stop[m], meetings.hold_m[e, minor])
    return -1
