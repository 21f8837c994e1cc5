"""Notes of what a track cannot give, in words."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.recordings.protocol import Track
from mirror.recordings.time import SECOND_NS

_METRES_PER_DEGREE: Final = 111_320.0
_SLOW_MPS: Final = 0.5
_LONG_GAP_S: Final = 2.0


def describe_track(track: Track) -> list[str]:
    """Describe a track: its rate, its gaps, and its parts without orientation or height."""
    stamps, first = np.unique(track.timestamp_ns, return_index=True)
    seconds = (stamps - stamps[0]) / SECOND_NS
    steps = np.diff(seconds)
    notes = [f"track: {len(track)} poses over {seconds[-1]:,.1f} s"]
    if track.bad is not None:
        notes.append(f"track: {len(track.bad.before)} rows make no pose: {track.bad.first}")
    if len(steps):
        notes[0] += f", one in {np.median(steps):.3g} s, between which motion is straight"
        if gaps := np.count_nonzero(steps > _LONG_GAP_S):
            notes.append(f"track: {gaps} gaps over {_LONG_GAP_S:g} s end a traversal (--max-gap-s of ingest)")
    if track.height_m is None:
        notes.append("heights: the track has none; the ROI's height_m is taken, or 0")
    elif np.isnan(track.height_m).any():
        notes.append(f"heights: {np.count_nonzero(np.isnan(track.height_m))} poses have none")
    if track.rotation is None:
        speed = _speeds(track, first, steps)
        slow = float(steps[speed < _SLOW_MPS].sum()) if len(steps) else 0.0
        notes.append(
            "orientation: the track has none; ingest takes the direction of travel, level: no pitch or roll, wrong in"
            " reverse and by the angle of drift, and as noisy as the fixes"
        )
        if slow > 0:
            notes.append(
                f"orientation: at standstill ({slow:,.1f} s of {seconds[-1]:,.1f} s below {_SLOW_MPS:g} m/s) it is held"
            )
    return notes


def _speeds(track: Track, order: np.ndarray, steps: Float64) -> Float64:
    """(N - 1,) speed between poses in the order of time, m/s; NaN where a position is missing."""
    if track.longitude_deg is not None and track.latitude_deg is not None:
        latitude = track.latitude_deg[order]
        x = track.longitude_deg[order] * np.cos(np.deg2rad(latitude)) * _METRES_PER_DEGREE
        y = latitude * _METRES_PER_DEGREE
    else:
        x, y = np.asarray(track.x_m)[order], np.asarray(track.y_m)[order]
    return np.asarray(np.hypot(np.diff(x), np.diff(y)) / steps, np.float64)
