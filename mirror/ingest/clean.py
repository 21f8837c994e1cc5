"""Cleaning of recorded fixes before the trigger sees them; everything that is removed is counted.

Rows that make no pose are no longer in the track (`mirror.recordings.bad_rows`): they are only counted. In one pass, in
time order:

- fixes that are not finite or off the globe are dropped (``invalid``);
- of equal stamps the first stays (``duplicate_time``); a fix earlier than one before it is sorted in, or the drive is
  refused (``backward_time``);
- fixes at the very place of the last good one collapse to the first (``repeated``): a receiver that repeats its fix
  moved on the straight line. Where the step out of such a run is one that a standing vehicle can make in that time
  (``min_step + a t^2 / 2``), it did stand still, and the whole run stays: a stop at a light is no gap. So it does at a
  track's end;
- speed test: a fix farther from the last good one than ``max_speed * t + noise`` is an outlier;
- acceleration test: a fix off the straight line between its neighbours by more than ``a t1 t2 / 2 + noise`` (what a
  vehicle that accelerates by ``a`` can be off) is an outlier, if the neighbours pass the speed test without it;
- after three fixes in a row that fail the speed test and agree with each other by the same test, the new track is taken
  up (``restarts``): motion across the break is unknown, as across a gap. A track of fewer than three fixes before a
  break is dropped with the outliers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from mirror.arrays import Float64, Int64, UInt8
from mirror.errors import RecordingError
from mirror.ingest.metric import scales, unwrap
from mirror.recordings.protocol import Track
from mirror.schema.documents import CleaningOptions, CleaningReport

_AGREEING = 3
# The fate of a fix. What is kept comes first, so that one comparison tells: KEPT, or kept as the start of a new track.
KEPT, RESTART, _INVALID, _DUPLICATE, _REPEATED, _OUTLIER = range(6)
_SCALE_REFRESH_DEG = 0.005
# Farther from the origin of a local metric frame no vehicle can be.
LOCAL_LIMIT_M = 1e9


@dataclass(frozen=True)
class CleanTrack:
    """A track in time order, each fix with its fate; the dropped ones stay in place, so that nothing is copied.

    Attributes:
        timestamp_ns: (N,) not decreasing; strictly increasing over the kept fixes.
        first: (N,) longitude in degrees, or x in metres.
        second: (N,) latitude in degrees, or y in metres.
        fate: (N,) `KEPT`, `RESTART` (kept; the motion from the fix before is unknown), or why it was dropped.
        order: (N,) row of each fix in the recorded track where time had to be sorted; None: as recorded.
        geodetic: whether the coordinates are longitude and latitude.
        sigma_m: (N,) horizontal 1-sigma, or None.
    """

    timestamp_ns: Int64
    first: Float64
    second: Float64
    fate: UInt8
    order: Int64 | None
    geodetic: bool
    sigma_m: Float64 | None

    def kept(self, start: int = 0, stop: int | None = None) -> Int64:
        """Positions of the kept fixes in ``start:stop``."""
        return np.flatnonzero(self.fate[start:stop] <= RESTART) + start

    def recorded(self, positions: Int64) -> Int64:
        """Rows of the recorded track at positions of this one."""
        return positions if self.order is None else self.order[positions]


def clean(track: Track, options: CleaningOptions, *, min_step_m: float = 0.5) -> tuple[CleanTrack, CleaningReport]:
    """Clean a track.

    Args:
        track: as recorded.
        options: the thresholds.
        min_step_m: what a standing vehicle may seem to move.

    Returns:
        The clean track and what was done to it.

    Raises:
        RecordingError: no fix at all, none left, or backward time where that is refused.
    """
    stamps = np.ascontiguousarray(track.timestamp_ns, np.int64)
    geodetic = track.longitude_deg is not None
    pair = (track.longitude_deg, track.latitude_deg) if geodetic else (track.x_m, track.y_m)
    if pair[0] is None or pair[1] is None:
        raise RecordingError("the track has neither longitude and latitude nor x and y", file=track.file)
    first, second = (np.ascontiguousarray(axis, np.float64) for axis in pair)
    if not len(stamps) == len(first) == len(second):
        raise RecordingError(f"{len(stamps)} stamps but {len(first)} and {len(second)} coordinates", file=track.file)
    if not len(stamps):
        if track.bad is not None:
            raise track.bad.first
        raise RecordingError("no pose at all", file=track.file, expected="at least one pose")

    order: Int64 | None = None
    backward, row = _backward(stamps)
    if backward:
        if options.backward_time == "refuse":
            raise RecordingError(
                f"time runs backward ({backward} poses)",
                file=track.file,
                place=f"pose {row}",
                expected="increasing time stamps",
                remedy="correct the recording, or let cleaning sort it: --backward-time sort",
            )
        order = np.argsort(stamps, kind="stable")
        stamps, first, second = stamps[order], first[order], second[order]
    fate = _judge(
        stamps,
        first,
        second,
        geodetic,
        options.max_speed_mps,
        options.max_acceleration_mps2,
        options.noise_m,
        min_step_m,
    )
    counts = [int(count) for count in _count(fate)]
    report = CleaningReport(
        poses=len(stamps) + (len(track.bad) if track.bad else 0),
        kept=counts[KEPT] + counts[RESTART],
        bad_rows=track.bad.counts() if track.bad else {},
        invalid=counts[_INVALID],
        missing=int(np.count_nonzero(np.isnan(first) | np.isnan(second))) if counts[_INVALID] else 0,
        backward_time=backward,
        duplicate_time=counts[_DUPLICATE],
        repeated=counts[_REPEATED],
        outliers=counts[_OUTLIER],
        restarts=counts[RESTART],
    )
    if not report.kept:
        raise RecordingError(
            f"none of {len(stamps)} poses is usable ({report.invalid} not finite or off the globe)",
            file=track.file,
            expected="positions on the globe, or in metres for a local frame",
            remedy="check the columns and the frame that the recording declares",
        )
    sigma = None if track.sigma_m is None else np.ascontiguousarray(track.sigma_m, np.float64)
    if sigma is not None and order is not None:
        sigma = sigma[order]
    return CleanTrack(stamps, first, second, fate, order, geodetic, sigma), report


@njit(cache=True, nogil=True)
def _count(fate: UInt8) -> Int64:
    counts = np.zeros(6, np.int64)
    for value in fate:
        counts[value] += 1
    return counts


@njit(cache=True, nogil=True)
def _backward(stamps: Int64) -> tuple[int, int]:
    """Number of stamps earlier than one before them, and the first such row."""
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


@njit(cache=True, nogil=True)
def _usable(first: float, second: float, geodetic: bool) -> bool:
    if geodetic:
        return abs(first) <= 180.0 and abs(second) <= 90.0
    return abs(first) < LOCAL_LIMIT_M and abs(second) < LOCAL_LIMIT_M


@njit(cache=True, nogil=True, inline="always")
def _follows(index: int, after: int, stamps: Int64, first: Float64, second: Float64, geodetic: bool) -> bool:
    """Whether ``after`` is a usable fix at another place and a later time."""
    return (
        stamps[after] > stamps[index]
        and _usable(first[after], second[after], geodetic)
        and not (first[after] == first[index] and second[after] == second[index])
    )


@njit(cache=True, nogil=True)
def _next_fix(index: int, stamps: Int64, first: Float64, second: Float64, geodetic: bool) -> int:
    """The first row that follows; the number of rows if none does."""
    for after in range(index + 1, len(stamps)):
        if _follows(index, after, stamps, first, second, geodetic):
            return after
    return len(stamps)


@njit(cache=True, nogil=True)
def _judge(
    stamps: Int64,
    first: Float64,
    second: Float64,
    geodetic: bool,
    max_speed: float,
    max_acceleration: float,
    noise: float,
    min_step: float,
) -> UInt8:
    """The fate of every fix."""
    total = len(stamps)
    fate = np.zeros(total, np.uint8)
    track_start, track_length = 0, 0
    last, run_end = -1, -1  # the last kept fix, and the last repetition of it
    rejected, rejected_start, agreeing = -1, -1, 0
    scale_x, scale_y, scale_at = 1.0, 1.0, np.inf
    noise2 = noise * noise
    # What the look ahead found of the step to the next row, where that row is a fix that follows a kept one.
    ahead, ex, ey, ahead2 = False, 0.0, 0.0, 0.0
    index = 0
    while index < total:
        x, y = first[index], second[index]
        if geodetic and not abs(y - scale_at) < _SCALE_REFRESH_DEG and _usable(x, y, True):
            scale_x, scale_y = scales(y, True)
            scale_at = y
        before = last
        if ahead:
            # Between two steps within the noise a fix passes both tests: kept, as nearly all are.
            while ahead2 <= noise2 and index + 1 < total:
                next_x, next_y = first[index + 1], second[index + 1]
                step_x, step_y = (next_x - x) * scale_x, (next_y - y) * scale_y
                step2 = step_x * step_x + step_y * step_y
                if not (
                    0.0 < step2 <= noise2
                    and stamps[index + 1] > stamps[index]
                    and _usable(next_x, next_y, geodetic)
                    and (not geodetic or abs(next_y - scale_at) < _SCALE_REFRESH_DEG)
                ):
                    break
                fate[index] = KEPT
                last, before = index, index
                track_length += 1
                index += 1
                x, y, ex, ey, ahead2 = next_x, next_y, step_x, step_y, step2
            ahead, dx, dy, moved2 = False, ex, ey, ahead2
        else:
            if not _usable(x, y, geodetic):
                fate[index] = _INVALID
                index += 1
                continue
            if last < 0:
                fate[index] = KEPT
                last, track_start, track_length = index, index, 1
                index += 1
                continue
            if stamps[index] == stamps[run_end if run_end >= 0 else last]:
                fate[index] = _DUPLICATE
                index += 1
                continue
            if x == first[last] and y == second[last]:
                fate[index] = _REPEATED
                run_end = index
                rejected, agreeing = -1, 0
                index += 1
                continue
            dx = unwrap(x - first[last], geodetic) * scale_x
            dy = (y - second[last]) * scale_y
            moved2 = dx * dx + dy * dy
            if run_end >= 0:
                dt = (stamps[index] - stamps[run_end]) * 1e-9
                reach = min_step + 0.5 * max_acceleration * dt * dt
                if moved2 <= reach * reach:
                    before = run_end
        dt = (stamps[index] - stamps[before]) * 1e-9
        reach = max_speed * dt + noise
        if moved2 <= reach * reach:
            # The neighbour is nearly always the next row; the search is for repeated and unusable ones.
            after = index + 1
            follows = after < total and _follows(index, after, stamps, first, second, geodetic)
            if not follows:
                after = _next_fix(index, stamps, first, second, geodetic)
            rejected, agreeing = -1, 0
            spike = False
            if after < total:
                ex = unwrap(first[after] - x, geodetic) * scale_x
                ey = (second[after] - y) * scale_y
                ahead2 = ex * ex + ey * ey
                if moved2 > noise2 or ahead2 > noise2:
                    dt2 = (stamps[after] - stamps[index]) * 1e-9
                    off_x, off_y = dx * dt2 - ex * dt, dy * dt2 - ey * dt
                    span = dt + dt2
                    allowed = (0.5 * max_acceleration * dt * dt2 + noise) * span
                    reach = max_speed * span + noise
                    spike = (
                        off_x * off_x + off_y * off_y > allowed * allowed
                        and (dx + ex) * (dx + ex) + (dy + ey) * (dy + ey) <= reach * reach
                    )
            if spike:
                fate[index] = _OUTLIER
            else:
                if before != last:
                    track_length += _restore(last, before, fate)
                fate[index] = KEPT
                last, run_end, ahead = index, -1, follows
                track_length += 1
            index += 1
            continue
        agrees = False
        if rejected >= 0:
            gap = (stamps[index] - stamps[rejected]) * 1e-9
            rx = unwrap(x - first[rejected], geodetic) * scale_x
            ry = (y - second[rejected]) * scale_y
            reach = max_speed * gap + noise
            agrees = rx * rx + ry * ry <= reach * reach
        if not agrees:
            rejected_start, agreeing = index, 1
        elif x != first[rejected] or y != second[rejected]:
            agreeing += 1
        rejected = index
        fate[index] = _OUTLIER
        index += 1
        if agreeing == _AGREEING:
            if run_end >= 0:
                track_length += _restore(last, run_end, fate)
                last = run_end
            if track_length < _AGREEING:
                for row in range(track_start, last + 1):
                    if fate[row] <= RESTART:
                        fate[row] = _OUTLIER
            fate[rejected_start] = RESTART
            last, track_start, track_length, run_end = rejected_start, rejected_start, 1, -1
            rejected, agreeing = -1, 0
            index = rejected_start + 1
    if run_end >= 0:
        _restore(last, run_end, fate)
    return fate


@njit(cache=True, nogil=True)
def _restore(last: int, run_end: int, fate: UInt8) -> int:
    """Keep a run of repetitions after all; their number."""
    count = 0
    for row in range(last + 1, run_end + 1):
        if fate[row] == _REPEATED:
            fate[row] = KEPT
            count += 1
    return count
