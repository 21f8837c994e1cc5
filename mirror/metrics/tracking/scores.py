"""CLEAR MOT, AMOTA and IDF1 of tracks on the ground plane.

K. Bernardin and R. Stiefelhagen, Evaluating multiple object tracking performance, 2008 (identity switches, MOTA); E.
Ristani et al., Performance measures and a data set for multi-target, multi-camera tracking, 2016 (IDF1); X. Weng et
al., 3D multi-object tracking, IROS 2020, with the recall-normalised MOTA of nuScenes (AMOTA over 40 recalls).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import UsageError
from mirror.metrics.inputs import as_numbers, require_rows

_RECALLS: Final = np.linspace(0.1, 1.0, 40)


@dataclass(frozen=True, eq=False)
class TrackedBoxes:
    """The N boxes of one frame.

    Attributes:
        track: (N,) ids of the objects, integers, not negative, each once.
        position_m: (N, 2) on the ground plane.
        velocity_mps: (N, 2); NaN where unknown.
        score: (N,) the score of the box's track; truth: not used.

    Raises:
        UsageError: shapes do not fit, or a number is not what stands above; its row is named.
    """

    track: Int64
    position_m: Float64
    velocity_mps: Float64
    score: Float64

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(self.track))
        shapes = {"track": (count,), "position_m": (count, 2), "velocity_mps": (count, 2), "score": (count,)}
        for name, shape in shapes.items():
            values = as_numbers(getattr(self, name), name, None if name == "track" else np.float64)
            if values.shape != shape:
                raise UsageError(f"{name} of shape {values.shape}", expected=str(shape))
            object.__setattr__(self, name, values)
        if count and self.track.dtype.kind not in "iu":
            raise UsageError(f"track of type {self.track.dtype}", expected="integers")
        require_rows(self.track >= 0, "track", self.track, "an id that is not negative")
        first = np.zeros(count, np.bool_)
        first[np.unique(self.track, return_index=True)[1]] = True
        require_rows(first, "track", self.track, "each id once in a frame")
        require_rows(np.isfinite(self.position_m).all(axis=1), "position_m", self.position_m, "finite numbers")
        known = ~np.isinf(self.velocity_mps).any(axis=1)
        require_rows(known, "velocity_mps", self.velocity_mps, "finite numbers, or NaN")
        require_rows(np.isfinite(self.score), "score", self.score, "a finite number")


@dataclass(frozen=True)
class TrackingScores:
    """The figures of a tracker over all frames of all drives.

    Attributes:
        mota: MOTA at the score threshold at which it is highest.
        amota: mean over 40 recalls from 0.1 to 1 of the recall-normalised MOTA; 0 for recalls that are not reached.
        switches: identity switches at the threshold of `mota`.
        misses: true boxes without a match there, as a share of all true boxes.
        false_per_frame: boxes without a true box there, per frame.
        idf1: F1 of boxes under the best one-to-one assignment of tracks, all boxes counted.
        position_error_m: mean distance of matched boxes at the threshold of `mota`.
        velocity_error_mps: mean error of the velocity of matched boxes there; NaN if it is unknown.
    """

    mota: float
    amota: float
    switches: int
    misses: float
    false_per_frame: float
    idf1: float
    position_error_m: float
    velocity_error_mps: float


@dataclass(frozen=True)
class _Counts:
    matches: int
    switches: int
    misses: int
    extra: int
    distance: float
    velocity: float
    known: int


def score_tracks(
    truth: Sequence[Sequence[TrackedBoxes]], found: Sequence[Sequence[TrackedBoxes]], *, threshold_m: float = 2.0
) -> TrackingScores:
    """Score tracks.

    Args:
        truth: true boxes by drive and frame.
        found: boxes of the tracker by drive and frame; ids of different drives do not matter to each other.
        threshold_m: boxes farther apart never match.

    Raises:
        UsageError: numbers of drives or frames differ, or there is no true box.
    """
    if [len(drive) for drive in truth] != [len(drive) for drive in found]:
        raise UsageError("truth and tracks of different frames", expected="the same drives with the same frames")
    total = sum(len(frame.track) for drive in truth for frame in drive)
    if not total:
        raise UsageError("no true boxes", expected="at least one")
    frames = sum(map(len, truth))
    scores = np.concatenate([frame.score for drive in found for frame in drive] or [np.empty(0)])
    best, best_mota, curve = None, -np.inf, np.full(len(_RECALLS), np.nan)
    for level in _levels(scores):
        counts = _sum([_count(one, other, level, threshold_m) for one, other in zip(truth, found)])
        mota = 1.0 - (counts.switches + counts.misses + counts.extra) / total
        if mota > best_mota:
            best, best_mota = counts, mota
        recall = counts.matches / total
        # MOTA normalised by the recall that is reached; levels fall, so the first that reaches a recall is taken.
        reached = (recall >= _RECALLS - 1e-9) & np.isnan(curve)
        curve[reached] = max(1.0 - (counts.switches + counts.extra) / max(counts.matches, 1), 0.0)
    if best is None:
        best = _Counts(0, 0, total, 0, 0.0, 0.0, 0)
        best_mota = 0.0
    return TrackingScores(
        mota=float(best_mota),
        amota=float(np.nan_to_num(curve).mean()),
        switches=best.switches,
        misses=best.misses / total,
        false_per_frame=best.extra / max(frames, 1),
        idf1=_idf1(truth, found, threshold_m),
        position_error_m=best.distance / best.matches if best.matches else float("nan"),
        velocity_error_mps=best.velocity / best.known if best.known else float("nan"),
    )


def _levels(scores: Float64) -> list[float]:
    """At most 40 thresholds of the score, falling, the last of which keeps all boxes."""
    if not len(scores):
        return []
    quantiles = np.quantile(scores, np.linspace(1.0, 0.0, 40), method="lower")
    return [float(level) for level in dict.fromkeys(quantiles.tolist())]


def _sum(parts: Sequence[_Counts]) -> _Counts:
    names = list(_Counts.__dataclass_fields__)
    return _Counts(**{name: sum(getattr(part, name) for part in parts) for name in names})


def _count(truth: Sequence[TrackedBoxes], found: Sequence[TrackedBoxes], level: float, threshold_m: float) -> _Counts:
    last: dict[int, int] = {}
    matches = switches = misses = extra = known = 0
    distance_sum = velocity_sum = 0.0
    for real, given in zip(truth, found):
        rows = np.flatnonzero(given.score >= level)
        if not len(real.track) or not len(rows):
            misses += len(real.track)
            extra += len(rows)
            continue
        away = np.linalg.norm(real.position_m[:, None] - given.position_m[None, rows], axis=-1)
        held = np.array([last.get(int(name), -1) for name in real.track])
        one, other = _pair(away, away <= threshold_m, held[:, None] == given.track[None, rows])
        for row, column in zip(one.tolist(), other.tolist()):
            name, track = int(real.track[row]), int(given.track[rows[column]])
            switches += last.get(name, track) != track
            last[name] = track
        matches += len(one)
        misses += len(real.track) - len(one)
        extra += len(rows) - len(one)
        distance_sum += float(away[one, other].sum())
        error = np.linalg.norm(real.velocity_mps[one] - given.velocity_mps[rows[other]], axis=1)
        known += int(np.isfinite(error).sum())
        velocity_sum += float(np.nansum(error))
    return _Counts(matches, switches, misses, extra, distance_sum, velocity_sum, known)


def _pair(away: Float64, near: Bool, held: Bool) -> tuple[Int64, Int64]:
    """Pair the boxes of one frame as CLEAR MOT does: pairs that last are kept, and only the rest is assigned.

    Args:
        away: (N, M) distances of true boxes from found ones.
        near: (N, M) which pairs are possible.
        held: (N, M) where the found box is of the track that the true object had last. Of several objects that had a
            track, the nearest keeps it.

    Returns:
        Rows and columns of the pairs.
    """
    from scipy.optimize import linear_sum_assignment

    paired_row, paired_column = np.zeros(away.shape[0], np.bool_), np.zeros(away.shape[1], np.bool_)
    pairs: list[tuple[int, int]] = []
    one, other = np.nonzero(near & held)
    for place in np.argsort(away[one, other], kind="stable").tolist():
        row, column = int(one[place]), int(other[place])
        if not (paired_row[row] or paired_column[column]):
            paired_row[row] = paired_column[column] = True
            pairs.append((row, column))
    rows, columns = np.flatnonzero(~paired_row), np.flatnonzero(~paired_column)
    left = np.ix_(rows, columns)
    # As many pairs as possible, and of these the nearest.
    one, other = linear_sum_assignment(np.where(near[left], away[left], 1e6))
    possible = near[left][one, other]
    pairs += zip(rows[one[possible]].tolist(), columns[other[possible]].tolist())
    result = np.array(pairs, np.int64).reshape(-1, 2)
    return result[:, 0], result[:, 1]


def _idf1(
    truth: Sequence[Sequence[TrackedBoxes]], found: Sequence[Sequence[TrackedBoxes]], threshold_m: float
) -> float:
    from scipy.optimize import linear_sum_assignment

    together = real_boxes = found_boxes = 0
    for real_drive, found_drive in zip(truth, found):
        real_ids = np.unique(np.concatenate([frame.track for frame in real_drive] or [np.empty(0, np.int64)]))
        found_ids = np.unique(np.concatenate([frame.track for frame in found_drive] or [np.empty(0, np.int64)]))
        shared = np.zeros((len(real_ids), len(found_ids)), np.int64)
        for real, given in zip(real_drive, found_drive):
            real_boxes += len(real.track)
            found_boxes += len(given.track)
            if len(real.track) and len(given.track):
                near = np.linalg.norm(real.position_m[:, None] - given.position_m[None], axis=-1) <= threshold_m
                one, other = np.nonzero(near)
                np.add.at(
                    shared,
                    (np.searchsorted(real_ids, real.track[one]), np.searchsorted(found_ids, given.track[other])),
                    1,
                )
        rows, columns = linear_sum_assignment(-shared)
        together += int(shared[rows, columns].sum())
    return 2.0 * together / max(real_boxes + found_boxes, 1)
