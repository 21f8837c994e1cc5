"""The nuScenes detection metrics (H. Caesar et al., CVPR 2020): mAP, true-positive errors, NDS.

Every figure has the bits that the development kit's ``DetectionEval.evaluate`` gives for the same centres, sizes, yaws,
velocities and scores.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np

from mirror.arrays import AnyArray, Bool, Float64
from mirror.errors import UsageError
from mirror.metrics.detection.boxes import DetectionBoxes
from mirror.metrics.detection.config import DETECTION_CVPR_2019, TP_ERRORS, DetectionConfig
from mirror.metrics.detection.curves import Curve, pair_errors, trace
from mirror.metrics.detection.matching import MatchingTable, matching_tables
from mirror.metrics.score import Score

AbsentClasses: TypeAlias = Literal["devkit", "present"]
ABSENT_CLASSES: Final[tuple[AbsentClasses, ...]] = get_args(AbsentClasses)


@dataclass(frozen=True, eq=False)
class NuScenesDetection:
    """The figures of a detector.

    Attributes:
        config: what they were computed with.
        absent: how classes without a true box count. ``devkit``: as AP 0 and errors 1, in every mean. ``present``: not.
        absent_classes: those classes.
        label_aps: (C, T) AP by class and threshold; 0 for absent classes.
        label_tp_errors: (C, 5) by class, in the order of `TP_ERRORS`; NaN where a class does not have an error.
        mean_ap: mAP; NaN with a reason under ``present`` if no class has a true box.
        tp_errors: means over classes, by name: mATE, mASE, mAOE, mAVE, mAAE.
        nds: nuScenes detection score.
        curves: by class and threshold.
    """

    config: DetectionConfig
    absent: AbsentClasses
    absent_classes: tuple[str, ...]
    label_aps: Float64
    label_tp_errors: Float64
    mean_ap: Score
    tp_errors: Mapping[str, Score]
    nds: Score
    curves: Mapping[tuple[str, float], Curve]

    def to_dict(self) -> dict[str, Any]:
        """Return the figures under the names of the development kit's ``metrics_summary.json``."""
        names = list(self.config.class_range)
        return {
            "label_aps": {
                name: dict(zip(map(str, self.config.dist_ths), row.tolist()))
                for name, row in zip(names, self.label_aps)
            },
            "mean_dist_aps": {name: float(np.mean(row)) for name, row in zip(names, self.label_aps)},
            "mean_ap": float(self.mean_ap),
            "label_tp_errors": {
                name: dict(zip(TP_ERRORS, row.tolist())) for name, row in zip(names, self.label_tp_errors)
            },
            "tp_errors": {name: float(error) for name, error in self.tp_errors.items()},
            "nd_score": float(self.nds),
            "absent": self.absent,
            "absent_classes": list(self.absent_classes),
            "cfg": self.config.to_dict(),
        }


def nuscenes_detection(
    truth: DetectionBoxes,
    predictions: DetectionBoxes,
    config: DetectionConfig = DETECTION_CVPR_2019,
    *,
    absent: AbsentClasses = "devkit",
) -> NuScenesDetection:
    """Score detections.

    Predictions take, by falling score, the nearest true box of their class and sample that is still free, if it is
    nearer than the threshold. Of equal scores the later row goes first; rows are in the order of the submission, sample
    by sample. Both sets are already cut to the range (`mirror.metrics.detection.in_range`).

    Args:
        truth: true boxes.
        predictions: predicted ones. Those in samples that the truth does not have are false positives.
        config: classes, thresholds, weights.
        absent: how classes count that no true box has: ``devkit`` as zero, ``present`` not at all.

    Raises:
        UsageError: a category is not among the classes, a sample has too many predictions, or ``absent`` is unknown.
    """
    if absent not in ABSENT_CLASSES:
        raise UsageError(f"absent classes as {absent!r}", expected=" | ".join(ABSENT_CLASSES))
    _require_few(predictions, config)
    return score_tables(matching_tables(truth, predictions, config), truth, predictions, config, absent=absent)


def score_tables(
    tables: Mapping[str, MatchingTable],
    truth: DetectionBoxes,
    predictions: DetectionBoxes,
    config: DetectionConfig,
    *,
    absent: AbsentClasses,
) -> NuScenesDetection:
    """Compute `nuscenes_detection` from matching tables that are already built."""
    curves: dict[tuple[str, float], Curve] = {}
    for name, table in tables.items():
        period = np.pi if name in config.half_turn_classes else 2 * np.pi
        score = predictions.score[table.predictions]
        for distance, rows in zip(config.dist_ths, table.assign(np.array(config.dist_ths), len(truth))):
            hit = rows >= 0
            errors = pair_errors(truth[rows[hit]], predictions[table.predictions[hit]], period)
            curves[name, distance] = trace(score, hit, table.truths, errors)
    label_aps = np.array(
        [
            [
                curves[name, distance].average_precision(config.min_recall, config.min_precision)
                for distance in config.dist_ths
            ]
            for name in tables
        ]
    )
    label_errors = np.array(
        [
            [
                np.nan
                if error in config.undefined_errors.get(name, ())
                else curves[name, config.dist_th_tp].error(error, config.min_recall)
                for error in TP_ERRORS
            ]
            for name in tables
        ]
    )
    missing = np.array([table.truths == 0 for table in tables.values()])
    counted = np.ones_like(missing) if absent == "devkit" else ~missing
    mean_ap = _mean([float(np.mean(row)) for row in label_aps[counted]], "no class has a true box")
    tp_errors = {
        name: _mean(label_errors[counted, column], f"no class that counts has {name}")
        for column, name in enumerate(TP_ERRORS)
    }
    return NuScenesDetection(
        config,
        absent,
        tuple(name for name, none in zip(tables, missing) if none),
        label_aps,
        label_errors,
        mean_ap,
        tp_errors,
        _detection_score(config, mean_ap, tp_errors),
        curves,
    )


class NuScenesAccumulator:
    """An accumulator of `nuscenes_detection`, for samples that come one after the other.

    Args:
        config: classes, thresholds, weights.
        absent: how classes count that no true box has.
    """

    def __init__(self, config: DetectionConfig = DETECTION_CVPR_2019, *, absent: AbsentClasses = "devkit") -> None:
        self.config = config
        self.absent: AbsentClasses = absent
        self._truth: list[DetectionBoxes] = []
        self._predictions: list[DetectionBoxes] = []

    def update(self, truth: DetectionBoxes, predictions: DetectionBoxes) -> None:
        """Add samples; among equal scores, later samples come first."""
        self._truth.append(truth)
        self._predictions.append(predictions)

    def merge(self, other: NuScenesAccumulator) -> None:
        """Append the samples of another accumulator.

        Raises:
            UsageError: the other one was made with another configuration.
        """
        if (other.config, other.absent) != (self.config, self.absent):
            raise UsageError("accumulators of different configurations", expected="one configuration")
        self._truth += other._truth
        self._predictions += other._predictions

    def compute(self) -> NuScenesDetection:
        """Return the figures of all samples so far.

        Raises:
            UsageError: as `nuscenes_detection`; or there are no samples.
        """
        if not self._truth:
            raise UsageError("no samples", expected="an update before compute")
        truth, predictions = map(DetectionBoxes.concatenate, (self._truth, self._predictions))
        return nuscenes_detection(truth, predictions, self.config, absent=self.absent)


def _mean(values: AnyArray | list[float], reason: str) -> Score:
    """Mean of what is not NaN."""
    numbers = ~np.isnan(values)
    if not numbers.any():
        return Score(float("nan"), reason)
    return Score(float(np.nanmean(values)))


def _detection_score(config: DetectionConfig, mean_ap: Score, tp_errors: Mapping[str, Score]) -> Score:
    reasons = [score.reason for score in (mean_ap, *tp_errors.values()) if score.reason is not None]
    if reasons:
        return Score(float("nan"), reasons[0])
    scores = [max(0.0, 1.0 - error) for error in tp_errors.values()]
    total = float(config.mean_ap_weight * mean_ap + np.sum(scores))
    return Score(total / float(config.mean_ap_weight + len(scores)))


def _require_few(predictions: DetectionBoxes, config: DetectionConfig) -> None:
    samples, counts = np.unique(predictions.sample, return_counts=True)
    many: Bool = counts > config.max_boxes_per_sample
    if many.any():
        sample, count = samples[np.argmax(many)], int(counts[np.argmax(many)])
        raise UsageError(
            f"{count} predictions",
            place=f"sample {sample}",
            expected=f"at most {config.max_boxes_per_sample}",
            remedy="leave out those with the lowest scores",
        )
