"""Cleaning of recorded position fixes before the trigger reads them. Every removed fix is counted.

The reader has already dropped bad rows (`mirror.recordings.bad_rows`); cleaning only adds their number to its report.
`mirror.ingest.fix_status` states and applies the rules.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirror.arrays import Float64, Int64, UInt8, read_only
from mirror.errors import RecordingError
from mirror.ingest.fix_status import (
    DUPLICATE,
    INVALID,
    KEPT,
    OUTLIER,
    REPEATED,
    RESTART,
    CleaningLimits,
    Fixes,
    count_backward,
    count_status,
    set_status,
    set_status_without_motion,
)
from mirror.recordings.protocol import Track
from mirror.schema.documents import CleaningOptions, CleaningReport


@dataclass(frozen=True)
class CleanTrack:
    """A track in time order with a status for each fix; dropped fixes stay in the arrays, to avoid copies.

    Attributes:
        timestamp_ns: (N,) not decreasing; strictly increasing over the kept fixes.
        lon_or_x: (N,) longitude in degrees, or x in metres.
        lat_or_y: (N,) latitude in degrees, or y in metres.
        status: (N,) `KEPT`, `RESTART` (kept; the motion from the fix before is unknown), or the reason it was dropped.
        order: (N,) the fix's row in the recorded track, where fixes had to be sorted by time; None: the same row.
        geodetic: whether the coordinates are longitude and latitude.
        sigma_m: (N,) horizontal standard deviation in metres, or None.
    """

    timestamp_ns: Int64
    lon_or_x: Float64
    lat_or_y: Float64
    status: UInt8
    order: Int64 | None
    geodetic: bool
    sigma_m: Float64 | None

    def kept(self, start: int = 0, stop: int | None = None) -> Int64:
        """Return the positions of the kept fixes in ``start:stop``, ascending."""
        return np.flatnonzero(self.status[start:stop] <= RESTART) + start

    def recorded(self, positions: Int64) -> Int64:
        """Return the rows in the recorded track of the fixes at given positions."""
        return positions if self.order is None else self.order[positions]

    def fixes(self) -> Fixes:
        """Return the track's arrays for compiled functions."""
        return _pack_fixes(self.timestamp_ns, self.lon_or_x, self.lat_or_y, self.status, self.geodetic)


def clean(
    track: Track, options: CleaningOptions, *, min_step_m: float = 0.5, has_motion: bool = True
) -> tuple[CleanTrack, CleaningReport]:
    """Clean a track.

    Args:
        track: as recorded, N fixes.
        options: the thresholds.
        min_step_m: the largest apparent motion of a standing vehicle.
        has_motion: False: the stamps only number the poses, and no pose is judged by a speed or by its repetition.

    Returns:
        The clean track with N fixes, and how many were dropped for each reason.

    Raises:
        RecordingError: the track has no fix, no fix is kept, or time runs backward and the options refuse that.
    """
    stamps, lon_or_x, lat_or_y, geodetic = _track_arrays(track)
    order: Int64 | None = None
    backward, row = count_backward(read_only(stamps))
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
        stamps, lon_or_x, lat_or_y = stamps[order], lon_or_x[order], lat_or_y[order]
    fixes = _pack_fixes(stamps, lon_or_x, lat_or_y, np.zeros(len(stamps), np.uint8), geodetic)
    limits = CleaningLimits(
        float(options.max_speed_mps), float(options.max_acceleration_mps2), float(options.noise_m), float(min_step_m)
    )
    if has_motion:
        set_status(fixes, limits)
    else:
        set_status_without_motion(fixes)
    counts = [int(count) for count in count_status(fixes.status)]
    report = CleaningReport(
        poses=len(stamps) + track.repeats + (len(track.bad) if track.bad else 0),
        kept=counts[KEPT] + counts[RESTART],
        bad_rows=track.bad.counts() if track.bad else {},
        invalid=counts[INVALID],
        missing=int(np.count_nonzero(np.isnan(lon_or_x) | np.isnan(lat_or_y))) if counts[INVALID] else 0,
        backward_time=backward,
        duplicate_time=counts[DUPLICATE] + track.repeats,
        repeated=counts[REPEATED],
        outliers=counts[OUTLIER],
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
    return CleanTrack(stamps, lon_or_x, lat_or_y, fixes.status, order, geodetic, sigma), report


def _pack_fixes(stamps_ns: Int64, lon_or_x: Float64, lat_or_y: Float64, status: UInt8, geodetic: bool) -> Fixes:
    """Pack arrays for compiled functions, as one type, whether readers give arrays that can be written to or not."""
    return Fixes(read_only(stamps_ns), read_only(lon_or_x), read_only(lat_or_y), status, geodetic)


def _track_arrays(track: Track) -> tuple[Int64, Float64, Float64, bool]:
    """Stamps and coordinates of a recorded track as contiguous (N,) arrays, and whether they are geodetic.

    Raises:
        RecordingError: coordinates are missing, or there is no pose.
    """
    stamps = np.ascontiguousarray(track.timestamp_ns, np.int64)
    geodetic = track.longitude_deg is not None
    pair = (track.longitude_deg, track.latitude_deg) if geodetic else (track.x_m, track.y_m)
    if pair[0] is None or pair[1] is None:
        raise RecordingError(
            "the track has neither longitude and latitude nor x and y",
            file=track.file,
            remedy="mend the reader: a track has one pair of coordinates",
        )
    lon_or_x, lat_or_y = (np.ascontiguousarray(axis, np.float64) for axis in pair)
    if not len(stamps):
        if track.bad is not None:
            raise track.bad.first
        raise RecordingError("no pose at all", file=track.file, expected="at least one pose")
    return stamps, lon_or_x, lat_or_y, geodetic
