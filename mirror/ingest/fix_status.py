"""Compiled rules of cleaning: which recorded fixes are kept, and why the others are dropped.

One loop goes through the fixes in time order and applies these rules:

- A fix that is not finite or off the globe is dropped (``invalid``).
- Of fixes with equal stamps the first is kept (``duplicate_time``). A fix that is earlier than one before it is sorted
  into its place, or the drive is refused (``backward_time``).
- Fixes at exactly the position of the last kept fix collapse to the first (``repeated``): the receiver repeated an old
  fix, and the vehicle moved on the straight line. If a standing vehicle can make the step that follows such a run
  (at most ``min_step + a t^2 / 2``), the vehicle stood still and all fixes of the run are kept: a stop at a traffic
  light is no gap. A run at the end of a track is kept too.
- Speed test: a fix farther than ``max_speed * t + noise`` from the last kept one is an outlier.
- Acceleration test: a fix off the straight line between its neighbours by more than ``a t1 t2 / 2 + noise`` (the most
  that a vehicle with acceleration ``a`` can deviate) is an outlier, if the neighbours pass the speed test without it.
- After three successive outliers that pass the speed test among themselves a new track starts with them
  (``restarts``). The motion across this break is unknown, as it is across a gap. A track with fewer than three fixes
  before the break is dropped as outliers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from mirror.arrays import Float64, Int64, UInt8
from mirror.compiled import compiled_above, inner_njit
from mirror.ingest.metric import PLAIN_ELEMENTS, scales, unwrap

_MIN_TRACK_FIXES = 3
# The status of a fix. `status <= RESTART` selects the kept ones; RESTART is kept as the first fix of a new track.
KEPT, RESTART, INVALID, DUPLICATE, REPEATED, OUTLIER = range(6)
_SCALE_REFRESH_DEG = 0.005
LOCAL_LIMIT_M = 1e9
"""No vehicle is farther than this from the origin of a local metric frame."""


class Fixes(NamedTuple):
    """The arrays of a track for compiled functions.

    Attributes:
        stamps_ns: (N,) time, not decreasing.
        lon_or_x: (N,) longitude in degrees, or x in metres.
        lat_or_y: (N,) latitude in degrees, or y in metres.
        status: (N,) see `CleanTrack`.
        geodetic: whether the coordinates are longitude and latitude.
    """

    stamps_ns: Int64
    lon_or_x: Float64
    lat_or_y: Float64
    status: UInt8
    geodetic: bool


class CleaningLimits(NamedTuple):
    """The thresholds of cleaning; lengths in metres, speed in m/s, acceleration in m/s^2."""

    max_speed: float
    max_acceleration: float
    noise: float
    min_step: float


@compiled_above(PLAIN_ELEMENTS)
def count_status(status: UInt8) -> Int64:
    """Return the number (6,) of fixes of each status."""
    counts = np.zeros(6, np.int64)
    for value in status:
        counts[value] += 1
    return counts


@compiled_above(PLAIN_ELEMENTS)
def count_backward(stamps: Int64) -> tuple[int, int]:
    """Count stamps that are earlier than a previous stamp; return also the row of the first one (-1: none)."""
    latest = stamps[0]
    count, row = 0, -1
    for index in range(len(stamps)):
        if stamps[index] < latest:
            count += 1
            if row < 0:
                row = index
        else:
            latest = stamps[index]
    return count, row


@inner_njit
def _is_usable(lon_or_x: float, lat_or_y: float, geodetic: bool) -> bool:
    """Return whether a position is finite and on the globe, or within `LOCAL_LIMIT_M`."""
    if geodetic:
        return abs(lon_or_x) <= 180.0 and abs(lat_or_y) <= 90.0
    return abs(lon_or_x) < LOCAL_LIMIT_M and abs(lat_or_y) < LOCAL_LIMIT_M


@njit(cache=True, nogil=True, inline="always")
def _is_next_fix(index: int, after: int, fixes: Fixes) -> bool:
    """Return whether row ``after`` is a usable fix at another position and a later time than row ``index``."""
    lon_or_x, lat_or_y = fixes.lon_or_x, fixes.lat_or_y
    return (
        fixes.stamps_ns[after] > fixes.stamps_ns[index]
        and _is_usable(lon_or_x[after], lat_or_y[after], fixes.geodetic)
        and not (lon_or_x[after] == lon_or_x[index] and lat_or_y[after] == lat_or_y[index])
    )


@inner_njit
def _find_next_fix(index: int, fixes: Fixes) -> int:
    """The first row after ``index`` for which `_is_next_fix` holds; N if there is none."""
    for after in range(index + 1, len(fixes.stamps_ns)):
        if _is_next_fix(index, after, fixes):
            return after
    return len(fixes.stamps_ns)


@compiled_above(PLAIN_ELEMENTS)
def set_status(fixes: Fixes, limits: CleaningLimits) -> None:
    """Set ``fixes.status`` by the rules of this module."""
    stamps, lon_or_x, lat_or_y, status, geodetic = fixes
    total = len(stamps)
    track_start, track_length = 0, 0
    last, run_end = -1, -1  # the last kept fix, and the last repetition of it
    rejected, rejected_start, agreeing = -1, -1, 0
    scale_x, scale_y, scale_at = 1.0, 1.0, np.inf
    noise2 = limits.noise * limits.noise
    # The step (ex, ey) in metres to the next row, if that row is known to be the fix that follows a kept one.
    is_step_known, ex, ey, next2 = False, 0.0, 0.0, 0.0
    index = 0
    while index < total:
        x, y = lon_or_x[index], lat_or_y[index]
        if geodetic and not abs(y - scale_at) < _SCALE_REFRESH_DEG and _is_usable(x, y, True):
            scale_x, scale_y = scales(y, True)
            scale_at = y
        before = last
        if is_step_known:
            # A fix between two steps within the noise passes both tests. Nearly all fixes are kept here.
            while next2 <= noise2 and index + 1 < total:
                next_x, next_y = lon_or_x[index + 1], lat_or_y[index + 1]
                step_x, step_y = (next_x - x) * scale_x, (next_y - y) * scale_y
                step2 = step_x * step_x + step_y * step_y
                if not (
                    0.0 < step2 <= noise2
                    and stamps[index + 1] > stamps[index]
                    and _is_usable(next_x, next_y, geodetic)
                    and (not geodetic or abs(next_y - scale_at) < _SCALE_REFRESH_DEG)
                ):
                    break
                status[index] = KEPT
                last, before = index, index
                track_length += 1
                index += 1
                x, y, ex, ey, next2 = next_x, next_y, step_x, step_y, step2
            is_step_known, dx, dy, moved2 = False, ex, ey, next2
        else:
            simple = _simple_status(index, last, run_end, fixes)
            if simple >= 0:
                status[index] = simple
                if simple == KEPT:
                    last, track_start, track_length = index, index, 1
                elif simple == REPEATED:
                    run_end = index
                    rejected, agreeing = -1, 0
                index += 1
                continue
            dx = unwrap(x - lon_or_x[last], geodetic) * scale_x
            dy = (y - lat_or_y[last]) * scale_y
            moved2 = dx * dx + dy * dy
            if run_end >= 0 and moved2 <= _standing_reach2(index, run_end, stamps, limits):
                before = run_end
        dt = (stamps[index] - stamps[before]) * 1e-9
        reach = limits.max_speed * dt + limits.noise
        if moved2 <= reach * reach:
            # The following fix is nearly always the next row; otherwise rows without a new position are skipped.
            after = index + 1
            is_next = after < total and _is_next_fix(index, after, fixes)
            if not is_next:
                after = _find_next_fix(index, fixes)
            rejected, agreeing = -1, 0
            is_spike = False
            if after < total:
                ex = unwrap(lon_or_x[after] - x, geodetic) * scale_x
                ey = (lat_or_y[after] - y) * scale_y
                next2 = ex * ex + ey * ey
                if moved2 > noise2 or next2 > noise2:
                    is_spike = _is_spike(dx, dy, dt, ex, ey, (stamps[after] - stamps[index]) * 1e-9, limits)
            if is_spike:
                status[index] = OUTLIER
            else:
                if before != last:
                    track_length += _keep_repetitions(last, before, status)
                status[index] = KEPT
                last, run_end, is_step_known = index, -1, is_next
                track_length += 1
            index += 1
            continue
        if rejected < 0 or not _is_reachable(index, rejected, scale_x, scale_y, fixes, limits):
            rejected_start, agreeing = index, 1
        elif x != lon_or_x[rejected] or y != lat_or_y[rejected]:
            agreeing += 1
        rejected = index
        status[index] = OUTLIER
        index += 1
        if agreeing == _MIN_TRACK_FIXES:
            _start_track(rejected_start, track_start, track_length, last, run_end, status)
            last, track_start, track_length, run_end = rejected_start, rejected_start, 1, -1
            rejected, agreeing = -1, 0
            index = rejected_start + 1
    if run_end >= 0:
        _keep_repetitions(last, run_end, status)


@compiled_above(PLAIN_ELEMENTS)
def set_status_without_motion(fixes: Fixes) -> None:
    """Set ``fixes.status`` if stamps only number the fixes: keep usable fixes, the first of each stamp."""
    stamps, lon_or_x, lat_or_y, status, geodetic = fixes
    last = -1
    for index in range(len(stamps)):
        if not _is_usable(lon_or_x[index], lat_or_y[index], geodetic):
            status[index] = INVALID
        elif last >= 0 and stamps[index] == stamps[last]:
            status[index] = DUPLICATE
        else:
            status[index], last = KEPT, index


@njit(cache=True, nogil=True, inline="always")
def _simple_status(index: int, last: int, run_end: int, fixes: Fixes) -> int:
    """The status of a fix if it needs no test of motion, else -1.

    ``last`` is the last kept fix (-1: none yet), ``run_end`` the last repetition of its position (-1: none).
    """
    stamps, lon_or_x, lat_or_y = fixes.stamps_ns, fixes.lon_or_x, fixes.lat_or_y
    if not _is_usable(lon_or_x[index], lat_or_y[index], fixes.geodetic):
        return INVALID
    if last < 0:
        return KEPT
    if stamps[index] == stamps[run_end if run_end >= 0 else last]:
        return DUPLICATE
    if lon_or_x[index] == lon_or_x[last] and lat_or_y[index] == lat_or_y[last]:
        return REPEATED
    return -1


@njit(cache=True, nogil=True, inline="always")
def _standing_reach2(index: int, run_end: int, stamps: Int64, limits: CleaningLimits) -> float:
    """Square of the longest step in metres that a vehicle can make that stood still until ``run_end``."""
    dt = (stamps[index] - stamps[run_end]) * 1e-9
    reach = limits.min_step + 0.5 * limits.max_acceleration * dt * dt
    return reach * reach


@njit(cache=True, nogil=True, inline="always")
def _is_spike(dx: float, dy: float, dt: float, ex: float, ey: float, dt2: float, limits: CleaningLimits) -> bool:
    """Return whether a fix fails the acceleration test.

    Args:
        dx: step to the fix in metres, along x.
        dy: along y.
        dt: seconds of it.
        ex: step from the fix to the next one in metres, along x.
        ey: along y.
        dt2: seconds of it.
        limits: the thresholds.
    """
    off_x, off_y = dx * dt2 - ex * dt, dy * dt2 - ey * dt
    span = dt + dt2
    allowed = (0.5 * limits.max_acceleration * dt * dt2 + limits.noise) * span
    reach = limits.max_speed * span + limits.noise
    return (
        off_x * off_x + off_y * off_y > allowed * allowed
        and (dx + ex) * (dx + ex) + (dy + ey) * (dy + ey) <= reach * reach
    )


@inner_njit
def _is_reachable(
    index: int, before: int, scale_x: float, scale_y: float, fixes: Fixes, limits: CleaningLimits
) -> bool:
    """Return whether the step between two fixes passes the speed test."""
    dt = (fixes.stamps_ns[index] - fixes.stamps_ns[before]) * 1e-9
    x = unwrap(fixes.lon_or_x[index] - fixes.lon_or_x[before], fixes.geodetic) * scale_x
    y = (fixes.lat_or_y[index] - fixes.lat_or_y[before]) * scale_y
    reach = limits.max_speed * dt + limits.noise
    return x * x + y * y <= reach * reach


@inner_njit
def _start_track(restart: int, track_start: int, track_length: int, last: int, run_end: int, status: UInt8) -> None:
    """End the track from ``track_start`` to ``last`` and start a new one at ``restart``.

    Repetitions of the last fix are kept. A track with fewer than three fixes becomes outliers.
    """
    if run_end >= 0:
        track_length += _keep_repetitions(last, run_end, status)
        last = run_end
    if track_length < _MIN_TRACK_FIXES:
        for row in range(track_start, last + 1):
            if status[row] <= RESTART:
                status[row] = OUTLIER
    status[restart] = RESTART


@inner_njit
def _keep_repetitions(last: int, run_end: int, status: UInt8) -> int:
    """Keep the repeated fixes after ``last`` up to ``run_end``. Returns their number."""
    count = 0
    for row in range(last + 1, run_end + 1):
        if status[row] == REPEATED:
            status[row] = KEPT
            count += 1
    return count
