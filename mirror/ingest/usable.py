"""How many rows of a drive may make no pose before the drive is refused."""

from __future__ import annotations

import math
from collections import Counter
from typing import Final

import numpy as np

from mirror.arrays import Bool
from mirror.errors import RecordingError
from mirror.ingest.clean import CleanTrack, clean
from mirror.ingest.fix_status import LOCAL_LIMIT_M
from mirror.recordings.coordinates import is_invalid_rotation
from mirror.recordings.protocol import Track
from mirror.recordings.row_faults import RowFaults
from mirror.schema.documents import CleaningOptions, CleaningReport, TriggerOptions

_LEAST_COVERED: Final = 0.9


def clean_usable(
    recorded: Track,
    cleaning: CleaningOptions,
    trigger: TriggerOptions,
    *,
    is_clip: bool,
    has_motion: bool = True,
) -> tuple[Track, CleanTrack, CleaningReport]:
    """Clean a track, and refuse it if too many of its rows give no pose.

    Bad rows are those that the reader dropped, rotations and standard deviations that are none, and positions that are
    infinite or off the globe. A row without a position is none of them: there was no fix. At most the share
    ``max_bad_rows`` of all rows may be bad, and the gaps over ``max_gap_s`` that bad rows leave may take a tenth of the
    drive's time. For a clip, which is judged whole, only the first holds.

    Args:
        recorded: as the reader gives it.
        cleaning: the thresholds.
        trigger: for ``max_gap_s`` and ``min_step_m``.
        is_clip: whether the source arrives as clips.
        has_motion: False: the stamps only number the poses.

    Returns:
        The track without bad rows, the same cleaned, and what was done to it.

    Raises:
        RecordingError: no fix at all, none left, too many bad rows, or backward time where that is refused.
    """
    track = _without_bad_values(recorded)
    cleaned, report = clean(track, cleaning, min_step_m=trigger.min_step_m, has_motion=has_motion)
    counts = Counter(report.bad_rows) + Counter(position=report.invalid - report.missing)
    bad = sum(counts.values())
    if not bad:
        return track, cleaned, report
    off = _off_the_globe(track)
    summary = f"{bad} of {report.poses} rows make no pose ({', '.join(f'{name} {n}' for name, n in counts.items())})"
    if bad > cleaning.max_bad_rows * report.poses:
        share = math.ceil(bad / report.poses * 1000) / 1000
        raise _refusal(track, off, f"{summary}, more than {cleaning.max_bad_rows:.2%}", f"--max-bad-rows {share}")
    if not is_clip:
        lost_s, drive_s, longest_s = _uncovered_s(track, off, trigger.max_gap_s)
        if lost_s > (1.0 - _LEAST_COVERED) * drive_s:
            problem = f"{summary}, and the gaps they leave are {lost_s:.1f} s of the drive's {drive_s:.1f} s"
            raise _refusal(track, off, problem, f"--max-gap-s {math.ceil(longest_s)}")
    return track, cleaned, report


def _without_bad_values(track: Track) -> Track:
    """The track without rotations and standard deviations that are none, whichever reader gave them."""
    faults = RowFaults(len(track))

    def error(problem: str, row: int, expected: str) -> RecordingError:
        remedy = "correct or remove the row"
        return RecordingError(problem, file=track.file, place=f"pose {row}", expected=expected, remedy=remedy)

    rotation, sigma = track.rotation, track.sigma_m
    if rotation is not None:
        faults.add(
            is_invalid_rotation(rotation),
            "rotation",
            lambda row: error(f"{rotation[row].tolist()} is no rotation", row, "a unit quaternion, scalar first"),
        )
    if sigma is not None:
        faults.add(
            (sigma < 0) | np.isinf(sigma),
            "sigma",
            lambda row: error(f"{sigma[row]} m is no standard deviation", row, "metres, or nothing"),
        )
    return faults.drop_from(track)


def _off_the_globe(track: Track) -> Bool:
    """Mark rows (N,) whose position is infinite or one that no vehicle can be at."""
    limits = (180.0, 90.0)
    lon_or_x, lat_or_y = track.longitude_deg, track.latitude_deg
    if lon_or_x is None or lat_or_y is None:
        lon_or_x, lat_or_y = np.asarray(track.x_m), np.asarray(track.y_m)
        limits = (LOCAL_LIMIT_M, LOCAL_LIMIT_M)
    off = (np.abs(lon_or_x) > limits[0]) | (np.abs(lat_or_y) > limits[1])
    return off & ~np.isnan(lon_or_x) & ~np.isnan(lat_or_y)


def _uncovered_s(track: Track, off: Bool, max_gap_s: float) -> tuple[float, float, float]:
    """The time in gaps over ``max_gap_s`` that bad rows leave, the drive's time, and the longest of the gaps."""
    good = np.flatnonzero(~off)
    before = np.flatnonzero(off) if track.bad is None else np.concatenate([np.flatnonzero(off), track.bad.before])
    after = np.unique(np.searchsorted(good, before))
    after = after[(after > 0) & (after < len(good))]
    stamps = track.timestamp_ns[good]
    gaps = np.abs(stamps[after] - stamps[after - 1]) * 1e-9
    gaps = gaps[gaps > max_gap_s]
    return float(gaps.sum()), float(stamps.max() - stamps.min()) * 1e-9, float(gaps.max(initial=0.0))


def _refusal(track: Track, off: Bool, problem: str, option: str) -> RecordingError:
    """The error of the first bad row, with what all of them come to."""
    if track.bad is not None:
        first = track.bad.first
    else:
        row = int(np.argmax(off))
        pair = (track.x_m, track.y_m) if track.longitude_deg is None else (track.longitude_deg, track.latitude_deg)
        place = ", ".join(str(axis[row]) for axis in pair if axis is not None)
        first = RecordingError(
            f"no vehicle can be at {place}",
            file=track.file,
            place=f"pose {row}",
            expected="a position on the globe, or in metres for a local frame",
            remedy="correct or remove the row",
        )
    return RecordingError(
        f"{first.problem}; {problem}",
        file=first.file,
        place=first.place,
        expected=first.expected,
        remedy=f"{first.remedy or 'correct or remove the row'}; or accept the drive without these rows: {option}",
    )
