"""Compiled search for visits: the maximal intervals in which a track is within a region of interest (ROI).

For most fixes a bound of the planar distance decides whether they are inside; the exact distance is computed only near
the circle. The crossing of the circle is found on the linear motion between two fixes.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from mirror.arrays import Int64, Records
from mirror.compiled import compiled_above, inner_njit
from mirror.ingest.fix_status import RESTART, Fixes
from mirror.ingest.grid import Circles
from mirror.ingest.metric import PLAIN_ELEMENTS, distance_m, plane_error, scales, unwrap

CROSSING, RECORDING_EDGE, GAP, STANDSTILL = range(4)
_TOLERANCE_M = 1e-6


class Visit(NamedTuple):
    """One visit of a ROI; also the columns of `VISIT`.

    Attributes:
        roi: number of the ROI.
        entry_ns: time of the entry.
        exit_ns: time of the exit.
        entry_lon_or_x: place of the entry.
        entry_lat_or_y: place of the entry.
        exit_lon_or_x: place of the exit.
        exit_lat_or_y: place of the exit.
        start: first position in the track between entry and exit; dropped fixes count.
        stop: position after the last one.
        entry_kind: `CROSSING`, `RECORDING_EDGE`, `GAP` or `STANDSTILL`.
        exit_kind: the same for the exit.
        closest_m: smallest distance from the ROI's centre.
    """

    roi: int
    entry_ns: int
    exit_ns: int
    entry_lon_or_x: float
    entry_lat_or_y: float
    exit_lon_or_x: float
    exit_lat_or_y: float
    start: int
    stop: int
    entry_kind: int
    exit_kind: int
    closest_m: float


def dtype_of_rows(row: type[tuple[Any, ...]]) -> np.dtype[np.void]:
    """Return the dtype of structured arrays with the fields of a named tuple: int64 for ``int``, else float64."""
    return np.dtype([(name, np.int64 if kind is int else np.float64) for name, kind in get_type_hints(row).items()])


VISIT = dtype_of_rows(Visit)
"""The dtype of arrays of visits."""


@inner_njit
def _solve(
    inside: float,
    outside: float,
    lon_or_x0: float,
    lat_or_y0: float,
    dlon_or_dx: float,
    dlat_or_dy: float,
    centre_lon_or_x: float,
    centre_lat_or_y: float,
    radius: float,
    geodetic: bool,
) -> float:
    """Find the share of a step at which the distance from the centre is the radius (Illinois method).

    ``inside`` is a share of the step within the circle and ``outside`` one beyond it.
    """
    low, high = inside, outside
    f_low = (
        distance_m(
            lon_or_x0 + low * dlon_or_dx, lat_or_y0 + low * dlat_or_dy, centre_lon_or_x, centre_lat_or_y, geodetic
        )
        - radius
    )
    f_high = (
        distance_m(
            lon_or_x0 + high * dlon_or_dx, lat_or_y0 + high * dlat_or_dy, centre_lon_or_x, centre_lat_or_y, geodetic
        )
        - radius
    )
    if f_low >= 0.0:
        return low
    if f_high <= 0.0:
        return high
    side = 0
    middle = low
    for _ in range(100):
        middle = (low * f_high - high * f_low) / (f_high - f_low)
        f = distance_m(
            lon_or_x0 + middle * dlon_or_dx, lat_or_y0 + middle * dlat_or_dy, centre_lon_or_x, centre_lat_or_y, geodetic
        )
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


@compiled_above(PLAIN_ELEMENTS)
def find_visits(fixes: Fixes, circles: Circles, stretches: Int64, max_gap_ns: int, out: Records) -> int:
    """Find the visits in the given stretches, in their order.

    Args:
        fixes: N fixes.
        circles: R ROIs.
        stretches: (S, 3) from `candidate_stretches`.
        max_gap_ns: a longer gap between kept fixes ends a visit.
        out: (M,) array of dtype `VISIT` that is filled.

    Returns:
        The number of visits. If it exceeds M, only the first M are stored: call again with a larger array.
    """
    stamps, lon_or_x, lat_or_y, status, geodetic = fixes
    centre_lon_or_x, centre_lat_or_y, radius_m = circles
    count = 0
    capacity = len(out)
    for row in range(len(stretches)):
        roi, begin, last = stretches[row, 0], stretches[row, 1], stretches[row, 2]
        c1, c2, radius = centre_lon_or_x[roi], centre_lat_or_y[roi], radius_m[roi]
        scale_x, scale_y = scales(c2, geodetic)
        scale_slope = _scale_slope(c2, geodetic)
        error = plane_error(c2, radius, geodetic)
        sure_inside, sure_outside = radius * max(0.0, 1.0 - error), radius * (1.0 + error)
        sure_inside, sure_outside = sure_inside * sure_inside, sure_outside * sure_outside
        is_open = False
        entry_ns, entry_1, entry_2, entry_kind, entry_at = 0, 0.0, 0.0, 0, 0
        closest2, closest_1, closest_2 = np.inf, 0.0, 0.0
        previous = -1
        was_inside = False
        px, py = 0.0, 0.0
        for position in range(begin, last + 1):
            if status[position] > RESTART:
                continue
            y = lat_or_y[position] - c2
            x, y = unwrap(lon_or_x[position] - c1, geodetic) * (scale_x + scale_slope * y), y * scale_y
            r2 = x * x + y * y
            inside = r2 <= sure_inside
            if not inside and r2 <= sure_outside:
                inside = distance_m(lon_or_x[position], lat_or_y[position], c1, c2, geodetic) <= radius
            if previous < 0 or status[position] == RESTART or stamps[position] - stamps[previous] > max_gap_ns:
                if is_open:
                    if count < capacity:
                        closest = distance_m(closest_1, closest_2, c1, c2, geodetic)
                        _enter(out, count, roi, entry_ns, entry_1, entry_2, entry_kind, entry_at, closest)
                        _leave(out, count, stamps[previous], lon_or_x[previous], lat_or_y[previous], GAP, position)
                    count += 1
                is_open = inside
                if inside:
                    entry_ns, entry_1, entry_2, entry_at = (
                        stamps[position],
                        lon_or_x[position],
                        lat_or_y[position],
                        position,
                    )
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
            f0, s0 = lon_or_x[previous], lat_or_y[previous]
            d1, d2 = unwrap(lon_or_x[position] - f0, geodetic), lat_or_y[position] - s0
            if not within and nearest2 <= sure_outside:
                # Both ends are outside, but the step may cut the circle between them.
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
                    if count < capacity:
                        closest = distance_m(closest_1, closest_2, c1, c2, geodetic)
                        _enter(out, count, roi, entry_ns, entry_1, entry_2, entry_kind, entry_at, closest)
                        exit_ns, exit_1 = stamps[previous] + np.int64(round(share * dt)), f0 + share * d1
                        _leave(out, count, exit_ns, unwrap(exit_1, geodetic), s0 + share * d2, CROSSING, position)
                    count += 1
                    is_open = False
            previous, was_inside, px, py = position, inside, x, y
        if is_open:
            if count < capacity:
                closest = distance_m(closest_1, closest_2, c1, c2, geodetic)
                _enter(out, count, roi, entry_ns, entry_1, entry_2, entry_kind, entry_at, closest)
                _leave(
                    out, count, stamps[previous], lon_or_x[previous], lat_or_y[previous], RECORDING_EDGE, previous + 1
                )
            count += 1
    return count


@inner_njit
def _scale_slope(lat_or_y: float, geodetic: bool) -> float:
    """Half the derivative by latitude of the metres per degree of longitude.

    With it a difference of longitudes is scaled at the middle latitude, which removes the first-order error of the
    planar distance.
    """
    if not geodetic:
        return 0.0
    scale_y = scales(lat_or_y, True)[1]
    return -0.5 * scale_y * math.sin(lat_or_y * math.pi / 180.0) * math.pi / 180.0


@inner_njit
def _enter(
    out: Records,
    number: int,
    roi: int,
    entry_ns: int,
    lon_or_x: float,
    lat_or_y: float,
    kind: int,
    start: int,
    closest_m: float,
) -> None:
    visit = out[number]
    visit.roi = roi
    visit.entry_ns, visit.entry_lon_or_x, visit.entry_lat_or_y, visit.entry_kind = entry_ns, lon_or_x, lat_or_y, kind
    visit.start, visit.closest_m = start, closest_m


@inner_njit
def _leave(out: Records, number: int, exit_ns: int, lon_or_x: float, lat_or_y: float, kind: int, stop: int) -> None:
    visit = out[number]
    visit.exit_ns, visit.exit_lon_or_x, visit.exit_lat_or_y, visit.exit_kind = exit_ns, lon_or_x, lat_or_y, kind
    visit.stop = stop
