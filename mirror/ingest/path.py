"""Compiled lengths of driven path, and the figures of a pass that follow from it.

Path counts only from one *counted* point to the next: a fix counts once it lies ``min_step`` (or ``step_sigmas`` sigmas
of the fix, if more) from the last counted one, so that the noise of a parked car adds nothing. The rest of the way to
the exit is added at the end, so that nothing of a straight drive is lost. Between counted points path grows linearly
with time, which is how it is shared out between inside and outside.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mirror.arrays import Float64, Int64, Records, UInt8
from mirror.ingest.clean import RESTART
from mirror.ingest.metric import scales, step_m, unwrap
from mirror.ingest.visits import CROSSING, STANDSTILL

# Excursions count as equally long within this; of equals the first is the longest, whatever the rounding.
_SAME_M = 1e-3
_SAME_NS = 1_000_000

FIGURES = np.dtype(
    [
        ("path_m", np.float64),
        ("inside_path_m", np.float64),
        ("heading_in_deg", np.float64),
        ("heading_out_deg", np.float64),
        ("closest_m", np.float64),
        ("poses", np.int64),
        ("inside_ns", np.int64),
        ("cut", np.int64),
    ]
)
"""What is measured of a pass: ``cut`` is the visit after its longest excursion; headings are NaN if nothing moved."""


@njit(cache=True, nogil=True)
def _counted(
    stamps: Int64,
    first: Float64,
    second: Float64,
    fate: UInt8,
    sigma: Float64,
    step_sigmas: float,
    min_step: float,
    geodetic: bool,
    candidate: Records,
    t: Int64,
    a: Float64,
    b: Float64,
    s: Float64,
) -> tuple[int, int, bool]:
    """Fill times, coordinates and cumulative path of the counted points.

    Returns:
        The number of points, that of the fixes, and whether the last point is but the rest of the way to the exit.
    """
    t[0], a[0], b[0], s[0] = candidate.entry_ns, candidate.entry_first, candidate.entry_second, 0.0
    count, fixes = 1, 0
    for position in range(candidate.start, candidate.stop):
        stamp = stamps[position]
        if fate[position] > RESTART or stamp < candidate.entry_ns or stamp > candidate.exit_ns:
            continue
        fixes += 1
        step = step_m(a[count - 1], b[count - 1], first[position], second[position], geodetic)
        least = min_step
        if len(sigma) and step_sigmas * sigma[position] > least:
            least = step_sigmas * sigma[position]
        if step >= least and stamp > t[count - 1]:
            t[count], a[count], b[count], s[count] = stamp, first[position], second[position], s[count - 1] + step
            count += 1
    rest = candidate.exit_ns > t[count - 1]
    if rest:
        step = step_m(a[count - 1], b[count - 1], candidate.exit_first, candidate.exit_second, geodetic)
        t[count], a[count], b[count] = candidate.exit_ns, candidate.exit_first, candidate.exit_second
        s[count] = s[count - 1] + step
        count += 1
    return count, fixes, rest


@njit(cache=True, nogil=True)
def _path_at(stamp: int, t: Int64, s: Float64, count: int) -> float:
    """Cumulative path at a time, linear between counted points."""
    index = np.searchsorted(t[:count], stamp)
    if index <= 0:
        return 0.0
    if index >= count:
        return s[count - 1]
    share = (stamp - t[index - 1]) / (t[index] - t[index - 1])
    return s[index - 1] + share * (s[index] - s[index - 1])


@njit(cache=True, nogil=True)
def _course_deg(a: Float64, b: Float64, index: int, geodetic: bool) -> float:
    scale_x, scale_y = scales(0.5 * (b[index] + b[index + 1]), geodetic)
    dx = unwrap(a[index + 1] - a[index], geodetic) * scale_x
    dy = (b[index + 1] - b[index]) * scale_y
    return math.degrees(math.atan2(dx, dy)) % 360.0


@njit(cache=True, nogil=True)
def figures(
    stamps: Int64,
    first: Float64,
    second: Float64,
    fate: UInt8,
    sigma: Float64,
    step_sigmas: float,
    min_step: float,
    geodetic: bool,
    candidates: Records,
    begin: Int64,
    end: Int64,
    found: Records,
    out: Records,
) -> None:
    """Measure passes.

    Args:
        stamps: (N,) time.
        first: (N,) longitude or x.
        second: (N,) latitude or y.
        fate: (N,) of each fix.
        sigma: (N,) horizontal 1-sigma of each fix, or (0,).
        step_sigmas: steps below this many sigmas do not count.
        min_step: nor do steps below this many metres.
        geodetic: whether the coordinates are degrees.
        candidates: (P,) `VISIT`: from the first visit's entry to the last one's exit, or the whole clip.
        begin: (P,) first visit of each pass.
        end: (P,) one behind its last.
        found: (V,) `VISIT`.
        out: (P,) `FIGURES`, filled.
    """
    longest = 0
    for row in range(len(candidates)):
        longest = max(longest, candidates[row].stop - candidates[row].start)
    t, a, b, s = np.empty(longest + 2, np.int64), np.empty(longest + 2), np.empty(longest + 2), np.empty(longest + 2)
    for row in range(len(candidates)):
        count, fixes, _ = _counted(
            stamps, first, second, fate, sigma, step_sigmas, min_step, geodetic, candidates[row], t, a, b, s
        )
        inside, inside_ns, left_at, closest = 0.0, 0, 0.0, np.inf
        longest_m, longest_ns, cut = -1.0, -1, -1
        for visit in range(begin[row], end[row]):
            entered_at = _path_at(found[visit].entry_ns, t, s, count)
            if visit > begin[row]:
                away_ns = found[visit].entry_ns - found[visit - 1].exit_ns
                away_m = entered_at - left_at
                if away_m > longest_m + _SAME_M or (away_m > longest_m - _SAME_M and away_ns > longest_ns + _SAME_NS):
                    longest_m, longest_ns, cut = away_m, away_ns, visit
            left_at = _path_at(found[visit].exit_ns, t, s, count)
            inside += left_at - entered_at
            inside_ns += found[visit].exit_ns - found[visit].entry_ns
            closest = min(closest, found[visit].closest_m)
        figure = out[row]
        figure.path_m, figure.inside_path_m, figure.closest_m = s[count - 1], inside, closest
        figure.poses, figure.inside_ns, figure.cut = fixes, inside_ns, cut
        figure.heading_in_deg, figure.heading_out_deg = np.nan, np.nan
        for index in range(count - 1):
            if s[index + 1] > s[index]:
                figure.heading_in_deg = _course_deg(a, b, index, geodetic)
                break
        for index in range(count - 2, -1, -1):
            if s[index + 1] > s[index]:
                figure.heading_out_deg = _course_deg(a, b, index, geodetic)
                break


@njit(cache=True, nogil=True)
def without_standstills(
    stamps: Int64,
    first: Float64,
    second: Float64,
    fate: UInt8,
    sigma: Float64,
    step_sigmas: float,
    min_step: float,
    geodetic: bool,
    found: Records,
    limit_ns: int,
    out: Records,
) -> int:
    """Cut out of visits what stands still for longer than the limit; the parts are visits of their own.

    A standstill lasts from a counted point to the last fix before the next counted one or the crossing; at the end of a
    recording or before a gap, to the end. Of a visit that is nothing else, an empty part stays at its entry, so that
    the ledger tells of it.

    Args:
        stamps: (N,) time.
        first: (N,) longitude or x.
        second: (N,) latitude or y.
        fate: (N,) of each fix.
        sigma: (N,) horizontal 1-sigma of each fix, or (0,).
        step_sigmas: steps below this many sigmas do not count.
        min_step: nor do steps below this many metres.
        geodetic: whether the coordinates are degrees.
        found: (V,) `VISIT`.
        limit_ns: the longest standstill that stays.
        out: room for the parts.

    Returns:
        The number of parts; where it exceeds ``len(out)``, only the first are stored: call again with more room.
    """
    longest = 0
    for row in range(len(found)):
        longest = max(longest, found[row].stop - found[row].start)
    t, a, b, s = np.empty(longest + 2, np.int64), np.empty(longest + 2), np.empty(longest + 2), np.empty(longest + 2)
    parts = 0
    for row in range(len(found)):
        visit = found[row]
        rest_ns, rest_first, rest_second, rest_kind = (
            visit.entry_ns,
            visit.entry_first,
            visit.entry_second,
            visit.entry_kind,
        )
        count, rest, before = 0, False, parts
        if visit.exit_ns - visit.entry_ns > limit_ns:
            count, _, rest = _counted(
                stamps, first, second, fate, sigma, step_sigmas, min_step, geodetic, visit, t, a, b, s
            )
        for index in range(count - 1):
            if t[index + 1] - t[index] <= limit_ns:
                continue
            left = t[index + 1]
            if index + 2 < count or not rest or visit.exit_kind == CROSSING:
                left = t[index]
                for position in range(visit.start, visit.stop):
                    if fate[position] <= RESTART and left < stamps[position] < t[index + 1]:
                        left = stamps[position]
            if left - t[index] <= limit_ns:
                continue
            if t[index] > rest_ns:
                _part(out, parts, visit, rest_ns, rest_first, rest_second, rest_kind)
                _end(out, parts, t[index], a[index], b[index])
                parts += 1
            rest_ns, rest_first, rest_second, rest_kind = left, a[index], b[index], STANDSTILL
        if visit.exit_ns > rest_ns or rest_kind != STANDSTILL:
            _part(out, parts, visit, rest_ns, rest_first, rest_second, rest_kind)
            parts += 1
        elif parts == before:
            _part(out, parts, visit, visit.entry_ns, visit.entry_first, visit.entry_second, visit.entry_kind)
            _end(out, parts, visit.entry_ns, visit.entry_first, visit.entry_second)
            parts += 1
    return parts


@njit(cache=True, nogil=True)
def _part(out: Records, number: int, visit: Records, entry_ns: int, first: float, second: float, kind: int) -> None:
    """Store a copy of a visit with another entry, if there is room."""
    if number < len(out):
        out[number] = visit
        part = out[number]
        part.entry_ns, part.entry_first, part.entry_second, part.entry_kind = entry_ns, first, second, kind


@njit(cache=True, nogil=True)
def _end(out: Records, number: int, exit_ns: int, first: float, second: float) -> None:
    """Let a stored part end in a standstill."""
    if number < len(out):
        part = out[number]
        part.exit_ns, part.exit_first, part.exit_second, part.exit_kind = exit_ns, first, second, STANDSTILL
