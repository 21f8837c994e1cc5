"""Conflict zones of two ways, and the right of way in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Float64, Int64
from mirror.portable import arrays, scalars
from mirror.traffic.lanes.network import Lane
from mirror.traffic.lanes.ways import STEP_M, Way

GRID_M: Final = 1.0
_STRIDE: Final = round(GRID_M / STEP_M)
# Lanes that end up to this distance before a zone still decide its right of way.
_BEFORE_M: Final = 12.0
_ALONG_M: Final = 6.0
_LINE_M: Final = 12.0
_KEEP_M: Final = 0.4
_NEAR: Final = 2
_STRAIGHTER_RAD: Final = 0.5


@dataclass(frozen=True, eq=False)
class Zone:
    """A conflict zone: the stretches of two ways, p and q, on which their users come too close to each other.

    Attributes:
        begin_m: (2,) length along p and along q at which the zone begins.
        end_m: (2,) length along p and along q at which it ends.
        limits: for p, the position up to which a user may advance while the rear end of the other user is at
            ``begin_m[1] + GRID_M * i`` on q; and the same for q.
        hold_m: (2,) position where each user waits if the other goes first: a nearby stop line, if there is one.
        along: whether both ways have the same direction, so that the second user follows the first.
        first: right of way: 0: p, 1: q, -1: the user that arrives first.
    """

    begin_m: tuple[float, float]
    end_m: tuple[float, float]
    limits: tuple[Float64, Float64]
    hold_m: tuple[float, float]
    along: bool
    first: int


def find_zones(p: Way, q: Way, clearance_m: float) -> list[Zone]:
    """Find the conflict zones of two ways.

    Args:
        p: a way.
        q: another way, or the same.
        clearance_m: distance below which the lines are in conflict.
    """
    if p is q:
        limit = np.maximum(GRID_M * np.arange(len(p.points[::_STRIDE])) - clearance_m, 0.0)
        return [Zone((0.0, 0.0), (p.length_m, p.length_m), (limit, limit), (0.0, 0.0), along=True, first=-1)]
    (p_low, p_high), (q_low, q_high) = p.bounds, q.bounds
    if (p_high + clearance_m < q_low).any() or (q_high + clearance_m < p_low).any():
        return []
    runs, owner = _find_runs(p.points[::_STRIDE], q.points[::_STRIDE], clearance_m)
    return [_make_zone(p, q, runs[owner == number]) for number in np.unique(owner)]


def _make_zone(p: Way, q: Way, runs: Int64) -> Zone:
    """The zone of runs (R, 3): index of a point of p, and of the first and the last point of q too close to it."""
    a0, a1, b0, b1 = runs[0, 0], runs[-1, 0], runs[:, 1].min(), runs[:, 2].max()
    limits = _zone_limits(runs, a0, a1, b0, b1)
    turned = p.heading_rad[_STRIDE * runs[:, 0]] - q.heading_rad[_STRIDE * ((runs[:, 1] + runs[:, 2]) // 2)]
    along = bool(GRID_M * min(a1 - a0, b1 - b0) > _ALONG_M and arrays.cos(turned).mean() > 0.7)
    begin, end = (float(GRID_M * a0), float(GRID_M * b0)), (float(GRID_M * a1), float(GRID_M * b1))
    hold = (_hold_position(p, begin[0]), _hold_position(q, begin[1]))
    return Zone(begin, end, limits, hold, along, _goes_first(p, q, begin, end, along))


def _hold_position(way: Way, begin_m: float) -> float:
    lines = [halt.at_m for halt in way.halts if begin_m - _LINE_M < halt.at_m < begin_m + 1.0]
    return min([begin_m - _KEEP_M, *lines])


def _goes_first(p: Way, q: Way, begin_m: tuple[float, float], end_m: tuple[float, float], along: bool) -> int:
    """Right of way: by lane; else against users that pull out, for crossing pedestrians, for users that go straight."""
    p_lanes, q_lanes = _zone_lanes(p, begin_m[0], end_m[0]), _zone_lanes(q, begin_m[1], end_m[1])
    p_yields = any(set(lane.yields_to) & {o.lane_id for o in q_lanes} for lane in p_lanes)
    q_yields = any(set(lane.yields_to) & {o.lane_id for o in p_lanes} for lane in q_lanes)
    if p_yields != q_yields:
        return 1 if p_yields else 0
    p_parks, q_parks = (way.lanes[0].use == "park" if way.lanes else False for way in (p, q))
    if p_parks != q_parks:
        return 1 if p_parks else 0
    p_walks, q_walks = (any(lane.use in ("walk", "cross") for lane in lanes) for lanes in (p_lanes, q_lanes))
    if p_walks != q_walks:
        return 0 if p_walks else 1
    p_turn, q_turn = (_zone_turn(way, begin, end) for way, begin, end in zip((p, q), begin_m, end_m))
    if not along and abs(p_turn - q_turn) > _STRAIGHTER_RAD:
        return 0 if p_turn < q_turn else 1
    return -1


def _zone_lanes(way: Way, begin_m: float, end_m: float) -> list[Lane]:
    low = max(int((begin_m - _BEFORE_M) / STEP_M), 0)
    high = int(min(end_m, begin_m + 30.0) / STEP_M) + 1
    return [way.lanes[n] for n in np.unique(way.lane_of[low:high]) if n >= 0]


def _zone_turn(way: Way, begin_m: float, end_m: float) -> float:
    low, high = max(begin_m - 8.0, 0.0), min(end_m + 8.0, way.length_m)
    return float(abs(way.heading_rad[int(high / STEP_M)] - way.heading_rad[int(low / STEP_M)]))


@njit(cache=True, nogil=True)
def _find_runs(a: Float64, b: Float64, clearance: float) -> tuple[Int64, Int64]:
    """Find the points of two lines, sampled every `GRID_M`, that are closer than the clearance.

    Returns:
        Runs (R, 3): index of a point of a, and of the first and the last of consecutive points of b; and the index (R,)
        of each run's zone. Runs of neighbouring points of a that almost touch share a zone, because bends separate
        lines for a short distance.
    """
    runs = np.empty((4 * len(a) + 16, 3), np.int64)
    owner = np.empty(len(runs), np.int64)
    count = 0
    for i in range(len(a)):
        j = 0
        while j < len(b) and count < len(runs):
            distance = scalars.hypot(a[i, 0] - b[j, 0], a[i, 1] - b[j, 1])
            if distance >= clearance:
                # No point can be in reach before the remaining distance is covered, so it is skipped.
                j += max(int((distance - clearance) / GRID_M), 1)
                continue
            start = j
            while j < len(b) and scalars.hypot(a[i, 0] - b[j, 0], a[i, 1] - b[j, 1]) < clearance:
                j += 1
            runs[count, 0], runs[count, 1], runs[count, 2] = i, start, j - 1
            owner[count] = count
            for k in range(count - 1, -1, -1):
                if runs[k, 0] < i - _NEAR:
                    break
                if runs[k, 1] <= j - 1 + _NEAR and runs[k, 2] >= start - _NEAR and owner[k] != owner[count]:
                    old, new = max(owner[k], owner[count]), min(owner[k], owner[count])
                    for n in range(count + 1):
                        if owner[n] == old:
                            owner[n] = new
            count += 1
    return runs[:count], owner[:count]


@njit(cache=True, nogil=True)
def _zone_limits(runs: Int64, a0: int, a1: int, b0: int, b1: int) -> tuple[Float64, Float64]:
    """Position up to which a user may advance on each line while the other is at, or before, a point of its line."""
    p, q = np.full(b1 - b0 + 1, np.inf), np.full(a1 - a0 + 1, np.inf)
    for i, low, high in runs:
        q[i - a0] = min(q[i - a0], GRID_M * low)
        for j in range(low, high + 1):
            p[j - b0] = min(p[j - b0], GRID_M * i)
    for limit in (p, q):
        for n in range(len(limit) - 2, -1, -1):
            limit[n] = min(limit[n], limit[n + 1])
    return p, q
