"""The fixes of a recording as positions in one metric frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.geometry.geodesy import TangentFrame
from mirror.recordings.protocol import Recording
from mirror.recordings.time import SECOND_NS

_LONGEST_S: Final = 3.0
"""Between fixes that are farther apart in time no position is interpolated."""


@dataclass(frozen=True, eq=False)
class TrackFixes:
    """The fixes of a drive.

    Attributes:
        time_ns: (N,) ascending times.
        places: (N, 3) metres, z up, NaN where a fix has no height.
        sigma_m: (N,) horizontal 1-sigma.
        frame: east-north-up at the first fix; None: the track has a metric frame of its own.
    """

    time_ns: Int64
    places: Float64
    sigma_m: Float64
    frame: TangentFrame | None

    def at(self, time_ns: Int64) -> tuple[Float64, Bool]:
        """Return positions (M, 3) at times, and at which (M,) there are fixes near enough."""
        columns = [np.interp(time_ns - self.time_ns[0], self.time_ns - self.time_ns[0], one) for one in self.places.T]
        after = np.clip(np.searchsorted(self.time_ns, time_ns), 1, len(self.time_ns) - 1)
        gap = self.time_ns[after] - self.time_ns[after - 1]
        inside = (time_ns >= self.time_ns[0]) & (time_ns <= self.time_ns[-1]) & (gap <= _LONGEST_S * SECOND_NS)
        return np.stack(columns, axis=1), np.asarray(inside, np.bool_)

    def sigma_at(self, time_ns: Int64) -> Float64:
        """Return the 1-sigma (M,) of the fixes at times."""
        return np.interp(time_ns - self.time_ns[0], self.time_ns - self.time_ns[0], self.sigma_m)


def read_fixes(recording: Recording, default_sigma_m: float) -> TrackFixes | None:
    """Read the fixes of a recording; repeated ones and those without a position are left out. None: it has under two.

    Args:
        recording: the recording.
        default_sigma_m: 1-sigma of fixes that state none.

    Raises:
        RecordingError: the track cannot be read.
    """
    track = recording.track()
    if track.longitude_deg is not None and track.latitude_deg is not None:
        first, second = track.longitude_deg, track.latitude_deg
        valid = np.isfinite(first) & np.isfinite(second) & (np.abs(first) <= 180.0) & (np.abs(second) <= 90.0)
    elif track.x_m is not None and track.y_m is not None:
        first, second = track.x_m, track.y_m
        valid = np.isfinite(first) & np.isfinite(second)
    else:
        return None
    height = track.height_m if track.height_m is not None else np.full(len(track), np.nan)
    order = np.argsort(track.timestamp_ns, kind="stable")
    order = order[valid[order]]
    # A receiver that repeats a fix states no new position.
    fresh = np.ones(len(order), np.bool_)
    fresh[1:] = (np.diff(track.timestamp_ns[order]) > 0) & (
        (np.diff(first[order]) != 0.0) | (np.diff(second[order]) != 0.0)
    )
    order = order[fresh]
    if len(order) < 2:
        return None
    stated = track.sigma_m[order] if track.sigma_m is not None else np.full(len(order), np.nan)
    sigma = np.where(np.isfinite(stated) & (stated > 0.0), stated, default_sigma_m)
    first, second, height = first[order], second[order], height[order]
    if track.longitude_deg is None:
        return TrackFixes(track.timestamp_ns[order], np.column_stack([first, second, height]), sigma, None)
    known = np.isfinite(height)
    frame = TangentFrame(float(first[0]), float(second[0]), float(height[known][0]) if known.any() else 0.0)
    places = frame.from_geodetic(first, second, np.where(known, height, frame.height_m))
    places[~known, 2] = np.nan
    return TrackFixes(track.timestamp_ns[order], places, sigma, frame)
