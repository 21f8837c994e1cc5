"""Where two ways are too close for two to be there at once, and who goes first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Bool, Float64, UInt8
from mirror.synth.driving.ways import STEP_M, Way
from mirror.synth.street.network import Lane

GRID_M: Final = 1.0
_STRIDE: Final = round(GRID_M / STEP_M)
# Lanes that end this far ahead of a zone still say who goes first in it.
_BEFORE_M: Final = 12.0
_ALONG_M: Final = 6.0
_LINE_M: Final = 12.0
_KEEP_M: Final = 0.4
_STRAIGHTER_RAD: Final = 0.5


@dataclass(frozen=True, eq=False)
class Zone:
    """A stretch of two ways, p and q, on which their users are in each other's way.

    Attributes:
        begin_m: (2,) where it begins on p and on q.
        end_m: (2,) where it ends.
        limits: on p: how far one may come while somebody's rear end is at ``begin_m[1] + GRID_M * i`` on q; and the
            same on q.
        hold_m: (2,) where each waits while the other goes first: at a stop line shortly before, if there is one.
        along: whether both go in one direction there: the second follows the first.
        first: 0: p goes first, 1: q does, -1: whoever is there first.
    """

    begin_m: tuple[float, float]
    end_m: tuple[float, float]
    limits: tuple[Float64, Float64]
    hold_m: tuple[float, float]
    along: bool
    first: int


def zones(p: Way, q: Way, clearance_m: float) -> list[Zone]:
    """The zones of two ways.

    Args:
        p: a way.
        q: a way, or the same.
        clearance_m: lines closer than this are in conflict.
    """
    a, b = (np.ascontiguousarray(way.points[::_STRIDE]) for way in (p, q))
    if (a.max(0) + clearance_m < b.min(0)).any() or (b.max(0) + clearance_m < a.min(0)).any():
        return []
    if p is q:
        limit = np.maximum(GRID_M * np.arange(len(a)) - clearance_m, 0.0)
        return [Zone((0.0, 0.0), (p.length_m, p.length_m), (limit, limit), (0.0, 0.0), along=True, first=-1)]
    close = _close(a, b, clearance_m)
    if not close.any():
        return []
    import cv2

    # Bends bring lines together for a metre more or less: what is nearly connected is one zone.
    count, label = cv2.connectedComponents(cv2.dilate(close, np.ones((5, 5), np.uint8)))
    label[close == 0] = 0
    return [_zone(p, q, label == number) for number in range(1, count)]


def _zone(p: Way, q: Way, hit: Bool) -> Zone:
    rows, columns = np.flatnonzero(hit.any(axis=1)), np.flatnonzero(hit.any(axis=0))
    (a0, a1), (b0, b1) = (rows[0], rows[-1]), (columns[0], columns[-1])
    inner = hit[a0 : a1 + 1, b0 : b1 + 1]
    limits = (_limits(inner, a0), _limits(inner.T, b0))
    i, j = np.nonzero(inner)
    turned = p.heading_rad[_STRIDE * (a0 + i)] - q.heading_rad[_STRIDE * (b0 + j)]
    long = GRID_M * min(a1 - a0, b1 - b0) > _ALONG_M
    along = bool(long and np.median(np.cos(turned)) > 0.7)
    begin, end = (GRID_M * a0, GRID_M * b0), (GRID_M * a1, GRID_M * b1)
    hold = (_hold(p, begin[0]), _hold(q, begin[1]))
    return Zone(begin, end, limits, hold, along, _first(p, q, begin, end, along))


def _hold(way: Way, begin_m: float) -> float:
    lines = [halt.at_m for halt in way.halts if begin_m - _LINE_M < halt.at_m < begin_m + 1.0]
    return min([begin_m - _KEEP_M, *lines])


def _limits(hit: Bool, start: int) -> Float64:
    """Of each column: the least row that is hit in it or any later one, as a length along the rows' way."""
    least = np.where(hit.any(axis=0), hit.argmax(axis=0), len(hit))
    return GRID_M * (start + np.minimum.accumulate(least[::-1])[::-1]).astype(np.float64)


def _first(p: Way, q: Way, begin_m: tuple[float, float], end_m: tuple[float, float], along: bool) -> int:
    """Who goes first: as the lanes say; not who pulls out; people who cross; those that go straight on."""
    own, other = _lanes(p, begin_m[0], end_m[0]), _lanes(q, begin_m[1], end_m[1])
    p_yields = any(set(lane.yields_to) & {o.lane_id for o in other} for lane in own)
    q_yields = any(set(lane.yields_to) & {o.lane_id for o in own} for lane in other)
    if p_yields != q_yields:
        return 1 if p_yields else 0
    p_parks, q_parks = (way.lanes[0].use == "park" if way.lanes else False for way in (p, q))
    if p_parks != q_parks:
        return 1 if p_parks else 0
    p_walks, q_walks = (any(lane.use in ("walk", "cross") for lane in lanes) for lanes in (own, other))
    if p_walks != q_walks:
        return 0 if p_walks else 1
    p_turn, q_turn = (_turn(way, begin, end) for way, begin, end in zip((p, q), begin_m, end_m))
    if not along and abs(p_turn - q_turn) > _STRAIGHTER_RAD:
        return 0 if p_turn < q_turn else 1
    return -1


def _lanes(way: Way, begin_m: float, end_m: float) -> list[Lane]:
    low = max(int((begin_m - _BEFORE_M) / STEP_M), 0)
    high = int(min(end_m, begin_m + 30.0) / STEP_M) + 1
    return [way.lanes[n] for n in np.unique(way.lane_of[low:high]) if n >= 0]


def _turn(way: Way, begin_m: float, end_m: float) -> float:
    low, high = max(begin_m - 8.0, 0.0), min(end_m + 8.0, way.length_m)
    return float(abs(way.heading_rad[int(high / STEP_M)] - way.heading_rad[int(low / STEP_M)]))


@njit(cache=True, nogil=True)
def _close(a: Float64, b: Float64, clearance: float) -> UInt8:
    """(len(a), len(b)) whether points are closer than the clearance; points of a line lie `GRID_M` apart."""
    found = np.zeros((len(a), len(b)), np.uint8)
    for i in range(len(a)):
        j = 0
        while j < len(b):
            distance = np.hypot(a[i, 0] - b[j, 0], a[i, 1] - b[j, 1])
            if distance < clearance:
                found[i, j] = 1
                j += 1
            else:
                # No point nearer than the distance that is missing can be in reach.
                j += max(int((distance - clearance) / GRID_M), 1)
    return found
