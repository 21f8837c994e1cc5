"""Compiled search for visits: the maximal intervals that a track spends within a region of interest.

A planar bound decides most poses, the exact distance only those close to the circle, and each crossing is solved for on
the linear motion between two fixes.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mirror.arrays import Float64, Int64, Records, UInt8
from mirror.ingest.clean import RESTART
from mirror.ingest.metric import distance_m, plane_error, scales, unwrap

CROSSING, RECORDING_EDGE, GAP, STANDSTILL = range(4)
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
        bend = _bend(c2, geodetic)
        error = plane_error(c2, radius, geodetic)
        sure_inside = (radius * max(0.0, 1.0 - error)) ** 2
        sure_outside = (radius * (1.0 + error)) ** 2
        is_open = False
        entry_ns, entry_1, entry_2, entry_kind, entry_at = 0, 0.0, 0.0, 0, 0
        closest2, closest_1, closest_2 = np.inf, 0.0, 0.0
        previous = -1
        was_inside = False
        px, py = 0.0, 0.0
        for position in range(begin, last + 1):
            if fate[position] > RESTART:
                continue
            y = second[position] - c2
            x, y = unwrap(first[position] - c1, geodetic) * (scale_x + bend * y), y * scale_y
            r2 = x * x + y * y
            inside = r2 <= sure_inside
            if not inside and r2 <= sure_outside:
                inside = distance_m(first[position], second[position], c1, c2, geodetic) <= radius
            if previous < 0 or fate[position] == RESTART or stamps[position] - stamps[previous] > max_gap_ns:
                if is_open:
                    if count < room:
                        closest = distance_m(closest_1, closest_2, c1, c2, geodetic)
                        _enter(out, count, roi, entry_ns, entry_1, entry_2, entry_kind, entry_at, closest)
                        _leave(out, count, stamps[previous], first[previous], second[previous], GAP, position)
                    count += 1
                is_open = inside
                if inside:
                    entry_ns, entry_1, entry_2, entry_at = stamps[position], first[position], second[position], position
                    entry_kind = RECORDING_EDGE if previous < 0 else GAP
                    closest2, closest_1, closest_2 = r2, entry_1, entry_2
                previous, was_inside, px, py = position, inside, x, y
                continue
            ex, ey = x - px, y - py
            length2 = ex * ex + ey * ey
            nearest = min(max(-(px * ex + py * ey) / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
            mx, my = px + nearest * ex, py + nearest * ey
            nearest2 = mx * mx + my * my
            within = was_inside or inside
            f0, s0 = first[previous], second[previous]
            d1, d2 = unwrap(first[position] - f0, geodetic), second[position] - s0
            if not within and nearest2 <= sure_outside:
                # Both ends outside: the step may still cut the circle between them.
                within = distance_m(f0 + nearest * d1, s0 + nearest * d2, c1, c2, geodetic) < radius
            if within:
                dt = stamps[position] - stamps[previous]
                if not was_inside:
                    share = 1.0 if inside else nearest
                    share = _solve(share, 0.0, f0, s0, d1, d2, c1, c2, radius, geodetic)
                    entry_ns = stamps[previous] + np.int64(round(share * dt))
                    entry_1, entry_2 = unwrap(f0 + share * d1, geodetic), s0 + share * d2
                    entry_kind, entry_at = CROSSING, position
                    is_open, closest2 = True, np.inf
                if nearest2 < closest2:
                    closest2, closest_1, closest_2 = nearest2, f0 + nearest * d1, s0 + nearest * d2
                if not inside:
                    share = 0.0 if was_inside else nearest
                    share = _solve(share, 1.0, f0, s0, d1, d2, c1, c2, radius, geodetic)
                    if count < room:
                        closest = distance_m(closest_1, closest_2, c1, c2, geodetic)
                        _enter(out, count, roi, entry_ns, entry_1, entry_2, entry_kind, entry_at, closest)
                        exit_ns, exit_1 = stamps[previous] + np.int64(round(share * dt)), f0 + share * d1
                        _leave(out, count, exit_ns, unwrap(exit_1, geodetic), s0 + share * d2, CROSSING, position)
                    count += 1
                    is_open = False
            previous, was_inside, px, py = position, inside, x, y
        if is_open:
            if count < room:
                closest = distance_m(closest_1, closest_2, c1, c2, geodetic)
                _enter(out, count, roi, entry_ns, entry_1, entry_2, entry_kind, entry_at, closest)
                _leave(out, count, stamps[previous], first[previous], second[previous], RECORDING_EDGE, previous + 1)
            count += 1
    return count


@njit(cache=True, nogil=True)
def _bend(second: float, geodetic: bool) -> float:
    """Half the change of metres a degree of longitude with each degree of latitude.

    With it, differences of longitude are scaled at the middle latitude, which takes the plane's first error away.
    """
    if not geodetic:
        return 0.0
    scale_y = scales(second, True)[1]
    return -0.5 * scale_y * math.sin(second * math.pi / 180.0) * math.pi / 180.0


@njit(cache=True, nogil=True)
def _enter(
    out: Records,
    number: int,
    roi: int,
    entry_ns: int,
    first: float,
    second: float,
    kind: int,
    start: int,
    closest_m: float,
) -> None:
    visit = out[number]
    visit.roi = roi
    visit.entry_ns, visit.entry_first, visit.entry_second, visit.entry_kind = entry_ns, first, second, kind
    visit.start, visit.closest_m = start, closest_m


@njit(cache=True, nogil=True)
def _leave(out: Records, number: int, exit_ns: int, first: float, second: float, kind: int, stop: int) -> None:
    visit = out[number]
    visit.exit_ns, visit.exit_first, visit.exit_second, visit.exit_kind = exit_ns, first, second, kind
    visit.stop = stop
