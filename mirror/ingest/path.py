"""Compiled lengths of driven path, and the figures of a pass that follow from them.

Path is measured between *counted* points. A fix counts if it is at least ``min_step`` (or ``step_sigmas`` standard
deviations of the fix, if that is more) from the last counted point, so that the noise of a parked car adds no path. The
remaining way to the exit is added at the end, so that no part of a straight drive is missing. Between counted points
path grows linearly with time; this divides it into the parts inside and outside of the ROI.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mirror.arrays import Float64, Int64, Records
from mirror.compiled import compiled_above, inner_njit
from mirror.ingest.fix_status import RESTART, Fixes
from mirror.ingest.metric import PLAIN_ELEMENTS, scales, step_m, unwrap
from mirror.ingest.visits import CROSSING, STANDSTILL, dtype_of_rows

# Excursions whose lengths or times differ by less than this count as equal: the choice does not depend on rounding.
_SAME_M = 1e-3
_SAME_NS = 1_000_000


class StepRule(NamedTuple):
    """The rule that decides which fixes count for the length of the path.

    Attributes:
        sigma_m: (N,) horizontal standard deviation of each fix, or (0,) if not known.
        step_sigmas: a step counts from this many standard deviations.
        min_step_m: a step counts from this length.
    """

    sigma_m: Float64
    step_sigmas: float
    min_step_m: float


class Figures(NamedTuple):
    """Measured figures of a pass, which are also the columns of `FIGURES`.

    Attributes:
        path_m: driven length.
        inside_path_m: the part of it within the ROI.
        heading_in_deg: direction of the first counted step, clockwise from north; NaN without a step.
        heading_out_deg: direction of the last counted step; NaN without a step.
        closest_m: smallest distance from the ROI's centre.
        poses: kept fixes between entry and exit.
        inside_ns: time within the ROI.
        cut: number of the visit after the longest excursion (`_find_cut`); -1 for a pass of one visit.
    """

    path_m: float
    inside_path_m: float
    heading_in_deg: float
    heading_out_deg: float
    closest_m: float
    poses: int
    inside_ns: int
    cut: int


FIGURES = dtype_of_rows(Figures)
"""The dtype of arrays of figures."""


class _Points(NamedTuple):
    """Buffers for counted points: time, coordinates and cumulative path in metres."""

    t: Int64
    lon_or_x: Float64
    lat_or_y: Float64
    path_m: Float64


@inner_njit
def _allocate_points(visits: Records) -> _Points:
    """Buffers for the points of the longest of the visits."""
    longest = 0
    for row in range(len(visits)):
        longest = max(longest, visits[row].stop - visits[row].start)
    size = longest + 2
    return _Points(np.empty(size, np.int64), np.empty(size), np.empty(size), np.empty(size))


@inner_njit
def _fill_points(fixes: Fixes, rule: StepRule, candidate: Records, points: _Points) -> tuple[int, int, bool]:
    """Fill the counted points of one pass.

    Returns:
        The number of points, the number of kept fixes, and whether the last point is the exit itself.
    """
    stamps, lon_or_x, lat_or_y, status, geodetic = fixes
    sigma, step_sigmas, min_step = rule
    t, a, b, s = points
    t[0], a[0], b[0], s[0] = candidate.entry_ns, candidate.entry_lon_or_x, candidate.entry_lat_or_y, 0.0
    count, kept = 1, 0
    for position in range(candidate.start, candidate.stop):
        stamp = stamps[position]
        if status[position] > RESTART or stamp < candidate.entry_ns or stamp > candidate.exit_ns:
            continue
        kept += 1
        step = step_m(a[count - 1], b[count - 1], lon_or_x[position], lat_or_y[position], geodetic)
        least = min_step
        if len(sigma) and step_sigmas * sigma[position] > least:
            least = step_sigmas * sigma[position]
        if step >= least and stamp > t[count - 1]:
            t[count], a[count], b[count], s[count] = stamp, lon_or_x[position], lat_or_y[position], s[count - 1] + step
            count += 1
    ends_at_exit = candidate.exit_ns > t[count - 1]
    if ends_at_exit:
        step = step_m(a[count - 1], b[count - 1], candidate.exit_lon_or_x, candidate.exit_lat_or_y, geodetic)
        t[count], a[count], b[count] = candidate.exit_ns, candidate.exit_lon_or_x, candidate.exit_lat_or_y
        s[count] = s[count - 1] + step
        count += 1
    return count, kept, ends_at_exit


@inner_njit
def _path_at(stamp: int, start: int, t: Int64, s: Float64, count: int) -> tuple[float, int]:
    """Cumulative path in metres at a time, linear between counted points.

    Args:
        stamp: the time.
        start: a point that is not after the first one at or after ``stamp``: the search begins with it.
        t: stamps of the points.
        s: cumulative path of the points.
        count: number of points.

    Returns:
        The path, and the first point at or after ``stamp``.
    """
    index = start
    while index < count and t[index] < stamp:
        index += 1
    if index == 0:
        return 0.0, 0
    if index >= count:
        return s[count - 1], index
    share = (stamp - t[index - 1]) / (t[index] - t[index - 1])
    return s[index - 1] + share * (s[index] - s[index - 1]), index


@inner_njit
def _course_deg(a: Float64, b: Float64, index: int, geodetic: bool) -> float:
    """Direction from point ``index`` to the next one in degrees, clockwise from north (from +y in a plane)."""
    scale_x, scale_y = scales(0.5 * (b[index] + b[index + 1]), geodetic)
    dx = unwrap(a[index + 1] - a[index], geodetic) * scale_x
    dy = (b[index + 1] - b[index]) * scale_y
    return math.degrees(math.atan2(dx, dy)) % 360.0


@compiled_above(PLAIN_ELEMENTS)
def measure_passes(
    fixes: Fixes, rule: StepRule, candidates: Records, begin: Int64, end: Int64, visits: Records, out: Records
) -> None:
    """Measure P passes.

    Args:
        fixes: N fixes.
        rule: which fixes count for the path.
        candidates: (P,) `VISIT`: from the entry of the first visit to the exit of the last one, or the whole clip.
        begin: (P,) number of the first visit of each pass.
        end: (P,) number after that of its last visit.
        visits: (V,) `VISIT`.
        out: (P,) `FIGURES`, filled.
    """
    points = _allocate_points(candidates)
    t, a, b, s = points
    most = 0
    for row in range(len(candidates)):
        most = max(most, end[row] - begin[row])
    away_m, away_ns = np.empty(most), np.empty(most, np.int64)
    for row in range(len(candidates)):
        count, kept, _ = _fill_points(fixes, rule, candidates[row], points)
        inside_m, inside_ns, exit_at, closest, point = 0.0, 0, 0.0, np.inf, 0
        for visit in range(begin[row], end[row]):
            entry_at, point = _path_at(visits[visit].entry_ns, point, t, s, count)
            if visit > begin[row]:
                away_ns[visit - begin[row] - 1] = visits[visit].entry_ns - visits[visit - 1].exit_ns
                away_m[visit - begin[row] - 1] = entry_at - exit_at
            exit_at, point = _path_at(visits[visit].exit_ns, point, t, s, count)
            inside_m += exit_at - entry_at
            inside_ns += visits[visit].exit_ns - visits[visit].entry_ns
            closest = min(closest, visits[visit].closest_m)
        figure = out[row]
        figure.path_m, figure.inside_path_m, figure.closest_m = s[count - 1], inside_m, closest
        excursions = end[row] - begin[row] - 1
        figure.poses, figure.inside_ns, figure.cut = kept, inside_ns, -1
        if excursions > 0:
            figure.cut = begin[row] + 1 + _find_cut(away_m[:excursions], away_ns[:excursions])
        figure.heading_in_deg, figure.heading_out_deg = np.nan, np.nan
        for index in range(count - 1):
            if s[index + 1] > s[index]:
                figure.heading_in_deg = _course_deg(a, b, index, fixes.geodetic)
                break
        for index in range(count - 2, -1, -1):
            if s[index + 1] > s[index]:
                figure.heading_out_deg = _course_deg(a, b, index, fixes.geodetic)
                break


@inner_njit
def _find_cut(away_m: Float64, away_ns: Int64) -> int:
    """The number of the longest excursion; of equally long ones the longest in time, of those the middle one.

    A pass with many equal excursions is halved at each cut, so that judging its parts takes a time of n log n and not
    of n squared.

    Args:
        away_m: (E,) lengths of the excursions.
        away_ns: (E,) their durations.
    """
    longest_m = away_m.max()
    longest_ns = -1
    for number in range(len(away_m)):
        if away_m[number] >= longest_m - _SAME_M:
            longest_ns = max(longest_ns, away_ns[number])
    found, distance = 0, 2 * len(away_m)
    for number in range(len(away_m)):
        if away_m[number] >= longest_m - _SAME_M and away_ns[number] >= longest_ns - _SAME_NS:
            from_middle = abs(2 * number + 1 - len(away_m))
            if from_middle < distance:
                found, distance = number, from_middle
    return found


@compiled_above(PLAIN_ELEMENTS)
def cut_standstills(fixes: Fixes, rule: StepRule, visits: Records, limit_ns: int, out: Records) -> int:
    """Cut standstills longer than a limit out of visits; each remaining part becomes a visit.

    A standstill lasts from a counted point to the last fix before the next counted point or the crossing. At the end of
    a recording and before a gap it lasts to the end. If a visit consists of nothing but a standstill, an empty part
    stays at its entry, so that the ledger lists the visit.

    Args:
        fixes: N fixes.
        rule: which fixes count for the path.
        visits: (V,) `VISIT`.
        limit_ns: the longest standstill that stays.
        out: (M,) array of dtype `VISIT` that is filled.

    Returns:
        The number of parts. If it exceeds M, only the first M are stored: call again with a larger array.
    """
    stamps, _, _, status, _ = fixes
    points = _allocate_points(visits)
    t, a, b, _ = points
    parts = 0
    for row in range(len(visits)):
        visit = visits[row]
        part_ns, part_lon_or_x, part_lat_or_y, part_kind = (
            visit.entry_ns,
            visit.entry_lon_or_x,
            visit.entry_lat_or_y,
            visit.entry_kind,
        )
        count, ends_at_exit, before = 0, False, parts
        if visit.exit_ns - visit.entry_ns > limit_ns:
            count, _, ends_at_exit = _fill_points(fixes, rule, visit, points)
        for index in range(count - 1):
            if t[index + 1] - t[index] <= limit_ns:
                continue
            standing_until = t[index + 1]
            if index + 2 < count or not ends_at_exit or visit.exit_kind == CROSSING:
                standing_until = t[index]
                for position in range(visit.start, visit.stop):
                    if status[position] <= RESTART and standing_until < stamps[position] < t[index + 1]:
                        standing_until = stamps[position]
            if standing_until - t[index] <= limit_ns:
                continue
            if t[index] > part_ns:
                _store_part(out, parts, visit, part_ns, part_lon_or_x, part_lat_or_y, part_kind)
                _end_part(out, parts, t[index], a[index], b[index])
                parts += 1
            part_ns, part_lon_or_x, part_lat_or_y, part_kind = standing_until, a[index], b[index], STANDSTILL
        if visit.exit_ns > part_ns or part_kind != STANDSTILL:
            _store_part(out, parts, visit, part_ns, part_lon_or_x, part_lat_or_y, part_kind)
            parts += 1
        elif parts == before:
            _store_part(out, parts, visit, visit.entry_ns, visit.entry_lon_or_x, visit.entry_lat_or_y, visit.entry_kind)
            _end_part(out, parts, visit.entry_ns, visit.entry_lon_or_x, visit.entry_lat_or_y)
            parts += 1
    return parts


@inner_njit
def _store_part(
    out: Records, number: int, visit: Records, entry_ns: int, lon_or_x: float, lat_or_y: float, kind: int
) -> None:
    """Store a copy of a visit with another entry, if the array has space."""
    if number < len(out):
        out[number] = visit
        part = out[number]
        part.entry_ns, part.entry_lon_or_x, part.entry_lat_or_y, part.entry_kind = entry_ns, lon_or_x, lat_or_y, kind


@inner_njit
def _end_part(out: Records, number: int, exit_ns: int, lon_or_x: float, lat_or_y: float) -> None:
    """End a stored part with a standstill."""
    if number < len(out):
        part = out[number]
        part.exit_ns, part.exit_lon_or_x, part.exit_lat_or_y, part.exit_kind = exit_ns, lon_or_x, lat_or_y, STANDSTILL
