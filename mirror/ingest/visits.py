"""Compiled search for visits: the maximal intervals that a track spends within a region of interest.

Two steps. `near` runs over the whole track once and finds, through a hash grid over the ROIs, the few stretches that
come near one: all the rest of a fleet's driving is never looked at again. `visits` then walks those stretches:
a planar bound decides most poses, the exact distance only those close to the circle, and each crossing is solved for
on the linear motion between two fixes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from mirror.arrays import Float64, Int64, Records, UInt8
from mirror.ingest.clean import RESTART
from mirror.ingest.metric import distance_m, scales, unwrap

CROSSING, RECORDING_EDGE, GAP, STANDSTILL = range(4)
_EARTH_M = 6_371_000.0
_TOLERANCE_M = 1e-6

VISIT = np.dtype(
    [
        ("roi", np.int64),
        ("entry_ns", np.int64),
        ("exit_ns", np.int64),
        ("entry_first", np.float64),
        ("entry_second", np.float64),
        ("exit_first", np.float64),
        ("exit_second", np.float64),
        ("start", np.int64),
        ("stop", np.int64),
        ("entry_kind", np.int64),
        ("exit_kind", np.int64),
        ("closest_m", np.float64),
    ]
)
"""One visit; ``start:stop`` are the track's positions between entry and exit, dropped fixes included."""


@dataclass(frozen=True)
class Grid:
    """A hash grid: cell -> the ROIs whose neighbourhood touches it.

    Attributes:
        origin: coordinates of cell (0, 0)'s corner.
        inverse: cells per unit of each coordinate.
        columns: cells round the globe, or 0 in a plane.
        keys: (H,) cell key of each slot, -1 for none; open addressing.
        begin: (H,) first entry in ``members`` of each slot.
        end: (H,) one behind the last.
        members: ROI numbers.
    """

    origin: tuple[float, float]
    inverse: tuple[float, float]
    columns: int
    keys: Int64
    begin: Int64
    end: Int64
    members: Int64


def build_grid(first: Float64, second: Float64, reach_m: Float64, geodetic: bool) -> Grid:
    """Build the grid.

    Args:
        first: (R,) ROI centres, longitude or x.
        second: (R,) ROI centres, latitude or y.
        reach_m: (R,) radius plus margin.
        geodetic: whether the coordinates are degrees.
    """
    metres = np.array([scales(float(value), geodetic) for value in second])
    half = np.column_stack([reach_m / np.maximum(metres[:, 0], 1e-3), reach_m / metres[:, 1]]) * 1.01
    if geodetic:
        half = np.minimum(half, [[180.0, 180.0]])
    cell = np.maximum(half.min(axis=0) * 0.5, 1e-9)
    columns = 0
    if geodetic:
        columns = max(1, int(360.0 / cell[0]))
        cell[0] = 360.0 / columns
    origin = (-180.0, -90.0) if geodetic else (float(first.min()), float(second.min()))
    cells: dict[int, list[int]] = {}
    for roi in range(len(first)):
        low = np.floor((np.array([first[roi], second[roi]]) - half[roi] - origin) / cell).astype(np.int64)
        high = np.floor((np.array([first[roi], second[roi]]) + half[roi] - origin) / cell).astype(np.int64)
        for column in range(low[0], min(high[0], low[0] + columns - 1 if columns else high[0]) + 1):
            wrapped = column % columns if columns else column
            for line in range(low[1], high[1] + 1):
                cells.setdefault(_key(wrapped, line), []).append(roi)
    slots = 1 << max(4, (4 * len(cells)).bit_length())
    keys, begin, end = np.full(slots, -1, np.int64), np.zeros(slots, np.int64), np.zeros(slots, np.int64)
    members: list[int] = []
    for key, rois in sorted(cells.items()):
        slot = _slot(key, slots)
        while keys[slot] != -1:
            slot = (slot + 1) & (slots - 1)
        keys[slot], begin[slot], end[slot] = key, len(members), len(members) + len(rois)
        members += rois
    return Grid(origin, (1.0 / cell[0], 1.0 / cell[1]), columns, keys, begin, end, np.array(members, np.int64))


@njit(cache=True, nogil=True, inline="always")
def _key(column: int, line: int) -> int:
    return ((column & 0x7FFFFFFF) << 31) | (line & 0x7FFFFFFF)


@njit(cache=True, nogil=True, inline="always")
def _slot(key: int, slots: int) -> int:
    mixed = (key ^ (key >> 29)) * 0x9E3779B1
    return (mixed ^ (mixed >> 15)) & (slots - 1)


@njit(cache=True, nogil=True)
def near(
    first: Float64,
    second: Float64,
    fate: UInt8,
    geodetic: bool,
    centre_first: Float64,
    centre_second: Float64,
    reach_m: Float64,
    origin: tuple[float, float],
    inverse: tuple[float, float],
    columns: int,
    keys: Int64,
    begin: Int64,
    end: Int64,
    members: Int64,
) -> Int64:
    """Stretches of kept fixes within reach of a ROI.

    Returns:
        (S, 3) ROI, first and last position; each stretch is one kept fix longer at both ends where there is one.
    """
    rois = len(centre_first)
    scale = np.empty((rois, 2))
    for roi in range(rois):
        scale[roi, 0], scale[roi, 1] = scales(centre_second[roi], geodetic)
    reach2 = (reach_m * 1.01) ** 2
    begun, reached, ordinal_seen = np.empty(rois, np.int64), np.empty(rois, np.int64), np.full(rois, -2, np.int64)
    found = np.empty((256, 3), np.int64)
    count = 0
    slots = len(keys)
    cell_x, cell_y, cell_begin, cell_end = -1, -1, 0, 0
    ordinal, previous = 0, -1
    for position in range(len(first)):
        if fate[position] > RESTART:
            continue
        # Truncation is a floor but for places before the origin; those only meet ROIs that the next test refuses.
        x = int((first[position] - origin[0]) * inverse[0])
        y = int((second[position] - origin[1]) * inverse[1])
        if x != cell_x or y != cell_y:
            cell_x, cell_y, cell_begin, cell_end = x, y, 0, 0
            column = x - columns if columns and x >= columns else x
            key = _key(column, y)
            slot = _slot(key, slots)
            while keys[slot] != -1:
                if keys[slot] == key:
                    cell_begin, cell_end = begin[slot], end[slot]
                    break
                slot = (slot + 1) & (slots - 1)
        for member in range(cell_begin, cell_end):
            roi = members[member]
            dx = unwrap(first[position] - centre_first[roi], geodetic) * scale[roi, 0]
            dy = (second[position] - centre_second[roi]) * scale[roi, 1]
            if dx * dx + dy * dy > reach2[roi]:
                continue
            if ordinal_seen[roi] != ordinal - 1:
                if ordinal_seen[roi] >= 0:
                    if count == len(found):
                        found = np.concatenate((found, np.empty_like(found)))
                    found[count, 0], found[count, 1], found[count, 2] = roi, begun[roi], reached[roi]
                    count += 1
                begun[roi] = position if previous < 0 else previous
            reached[roi], ordinal_seen[roi] = position, ordinal
        previous = position
        ordinal += 1
    for roi in range(rois):
        if ordinal_seen[roi] >= 0:
            if count == len(found):
                found = np.concatenate((found, np.empty_like(found)))
            found[count, 0], found[count, 1], found[count, 2] = roi, begun[roi], reached[roi]
            count += 1
    for row in range(count):
        after = found[row, 2] + 1
        while after < len(first) and fate[after] > RESTART:
            after += 1
        if after < len(first):
            found[row, 2] = after
    return found[:count].copy()


@njit(cache=True, nogil=True)
def _solve(
    inside: float,
    outside: float,
    first0: float,
    second0: float,
    dfirst: float,
    dsecond: float,
    centre_first: float,
    centre_second: float,
    radius: float,
    geodetic: bool,
) -> float:
    """Where on a step, between a share within the circle and one beyond it, the distance is the radius (Illinois)."""
    low, high = inside, outside
    f_low = distance_m(first0 + low * dfirst, second0 + low * dsecond, centre_first, centre_second, geodetic) - radius
    f_high = (
        distance_m(first0 + high * dfirst, second0 + high * dsecond, centre_first, centre_second, geodetic) - radius
    )
    if f_low >= 0.0:
        return low
    if f_high <= 0.0:
        return high
    side = 0
    middle = low
    for _ in range(100):
        middle = (low * f_high - high * f_low) / (f_high - f_low)
        f = distance_m(first0 + middle * dfirst, second0 + middle * dsecond, centre_first, centre_second, geodetic)
        f -= radius
        if abs(f) < _TOLERANCE_M:
            break
        if f > 0.0:
            high, f_high = middle, f
            if side == 1:
                f_low *= 0.5
            side = 1
        else:
            low, f_low = middle, f
            if side == -1:
                f_high *= 0.5
            side = -1
    return middle


@njit(cache=True, nogil=True)
def visits(
    stamps: Int64,
    first: Float64,
    second: Float64,
    fate: UInt8,
    geodetic: bool,
    centre_first: Float64,
    centre_second: Float64,
    radius_m: Float64,
    stretches: Int64,
    max_gap_ns: int,
    out: Records,
) -> int:
    """Visits of the given stretches, in their order.

    Args:
        stamps: (N,) time.
        first: (N,) longitude or x.
        second: (N,) latitude or y.
        fate: (N,) of each fix.
        geodetic: whether the coordinates are degrees.
        centre_first: (R,) ROI centres.
        centre_second: (R,) ROI centres.
        radius_m: (R,) ROI radii.
        stretches: (S, 3) from `near`.
        max_gap_ns: a longer gap between fixes ends a visit.
        out: room for visits, of dtype `VISIT`.

    Returns:
        The number of visits; where it exceeds ``len(out)``, only the first are stored: call again with more room.
    """
    count = 0
    room = len(out)
    for row in range(len(stretches)):
        roi, begin, last = stretches[row, 0], stretches[row, 1], stretches[row, 2]
        c1, c2, radius = centre_first[roi], centre_second[roi], radius_m[roi]
        scale_x, scale_y = scales(c2, geodetic)
        guard = 0.0
        if geodetic:
            guard = 4.0 * radius / _EARTH_M * (1.0 + abs(math.tan(c2 * math.pi / 180.0))) + 1e-6
        sure_inside = (radius * max(0.0, 1.0 - guard)) ** 2
        sure_outside = (radius * (1.0 + guard)) ** 2
        is_open = False
        entry_ns, entry_1, entry_2, entry_kind, entry_at = 0, 0.0, 0.0, 0, 0
        closest = np.inf
        previous = -1
        was_inside = False
        px, py = 0.0, 0.0
        for position in range(begin, last + 1):
            if fate[position] > RESTART:
                continue
            x, y = unwrap(first[position] - c1, geodetic) * scale_x, (second[position] - c2) * scale_y
            r2 = x * x + y * y
            inside = r2 <= sure_inside
            if not inside and r2 <= sure_outside:
                inside = distance_m(first[position], second[position], c1, c2, geodetic) <= radius
            gap = previous < 0 or fate[position] == RESTART or stamps[position] - stamps[previous] > max_gap_ns
            closes_at, close_kind = -1.0, CROSSING
            opens_at = -1.0
            if gap:
                if is_open:
                    closes_at, close_kind = 0.0, GAP
            elif was_inside != inside:
                d1, d2 = unwrap(first[position] - first[previous], geodetic), second[position] - second[previous]
                share_in, share_out = (0.0, 1.0) if was_inside else (1.0, 0.0)
                share = _solve(share_in, share_out, first[previous], second[previous], d1, d2, c1, c2, radius, geodetic)
                if inside:
                    opens_at = share
                else:
                    closes_at = share
            elif not inside:
                # Both ends outside: the step may still cut the circle between them.
                ex, ey = x - px, y - py
                length2 = ex * ex + ey * ey
                nearest = -(px * ex + py * ey) / length2 if length2 > 0.0 else -1.0
                if 0.0 < nearest < 1.0:
                    mx, my = px + nearest * ex, py + nearest * ey
                    if mx * mx + my * my <= sure_outside:
                        d1, d2 = (
                            unwrap(first[position] - first[previous], geodetic),
                            second[position] - second[previous],
                        )
                        f0, s0 = first[previous], second[previous]
                        r = distance_m(f0 + nearest * d1, s0 + nearest * d2, c1, c2, geodetic)
                        if r < radius:
                            opens_at = _solve(nearest, 0.0, f0, s0, d1, d2, c1, c2, radius, geodetic)
                            closes_at = _solve(nearest, 1.0, f0, s0, d1, d2, c1, c2, radius, geodetic)
                            closest = r
            if opens_at >= 0.0:
                f0, s0 = first[previous], second[previous]
                d1, d2 = unwrap(first[position] - f0, geodetic), second[position] - s0
                entry_ns = stamps[previous] + np.int64(round(opens_at * (stamps[position] - stamps[previous])))
                entry_1, entry_2, entry_kind, entry_at = f0 + opens_at * d1, s0 + opens_at * d2, CROSSING, position
                is_open = True
            if closes_at >= 0.0:
                f0, s0 = first[previous], second[previous]
                d1, d2, dt = 0.0, 0.0, np.int64(0)
                if close_kind == CROSSING:
                    d1, d2 = unwrap(first[position] - f0, geodetic), second[position] - s0
                    dt = np.int64(round(closes_at * (stamps[position] - stamps[previous])))
                if count < room:
                    _store(out, count, roi, entry_ns, entry_1, entry_2, entry_kind, entry_at, closest)
                    visit = out[count]
                    visit.exit_ns = stamps[previous] + dt
                    visit.exit_first, visit.exit_second = f0 + closes_at * d1, s0 + closes_at * d2
                    visit.stop = position
                    visit.exit_kind = close_kind
                count += 1
                is_open = False
                closest = np.inf
            if gap and inside:
                entry_ns, entry_1, entry_2, entry_at = stamps[position], first[position], second[position], position
                entry_kind = RECORDING_EDGE if previous < 0 else GAP
                is_open = True
            if inside:
                r = math.sqrt(r2)
                if r < closest * (1.0 + 2.0 * guard):
                    closest = min(closest, distance_m(first[position], second[position], c1, c2, geodetic))
            previous, was_inside, px, py = position, inside, x, y
        if is_open:
            if count < room:
                _store(out, count, roi, entry_ns, entry_1, entry_2, entry_kind, entry_at, closest)
                visit = out[count]
                visit.exit_ns = stamps[previous]
                visit.exit_first, visit.exit_second = first[previous], second[previous]
                visit.stop = previous + 1
                visit.exit_kind = RECORDING_EDGE
            count += 1
    return count


@njit(cache=True, nogil=True)
def _store(
    out: Records,
    count: int,
    roi: int,
    entry_ns: int,
    entry_1: float,
    entry_2: float,
    entry_kind: int,
    entry_at: int,
    closest: float,
) -> None:
    visit = out[count]
    visit.roi = roi
    visit.entry_ns = entry_ns
    visit.entry_first = entry_1
    visit.entry_second = entry_2
    visit.entry_kind = entry_kind
    visit.start = entry_at
    visit.closest_m = closest
