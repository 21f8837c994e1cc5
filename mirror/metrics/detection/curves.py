"""Precision, confidence and the errors of true positives along recall, and the figures read from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import AnyArray, Bool, Float64
from mirror.metrics.detection.boxes import DetectionBoxes
from mirror.metrics.detection.config import TP_ERRORS
from mirror.metrics.detection.matching import centre_distance

RECALL: Final = np.linspace(0.0, 1.0, 101)


@dataclass(frozen=True, eq=False)
class Curve:
    """Precision, confidence and errors of one class at one threshold, at the recalls `RECALL`.

    Attributes:
        precision: (101,).
        confidence: (101,) 0 beyond the recall that is reached.
        errors: (101,) each: mean error of the true positives up to there, by name.
    """

    precision: Float64
    confidence: Float64
    errors: Mapping[str, Float64]

    def average_precision(self, min_recall: float, min_precision: float) -> float:
        """Return the mean precision over recalls above ``min_recall``, rescaled from ``min_precision``..1 to 0..1."""
        precision = self.precision[_first(min_recall) :] - min_precision
        precision[precision < 0.0] = 0.0
        return float(np.mean(precision)) / (1.0 - min_precision)

    def error(self, name: str, min_recall: float) -> float:
        """Return the mean of one error from ``min_recall`` to the reached recall; 1 if that is below ``min_recall``."""
        reached = np.flatnonzero(self.confidence)
        first, last = _first(min_recall), int(reached[-1]) if len(reached) else 0
        if last < first:
            return 1.0
        return float(np.mean(self.errors[name][first : last + 1]))


NO_MATCHES: Final = Curve(np.zeros(101), np.zeros(101), {name: np.ones(101) for name in TP_ERRORS})
"""The value of a class that is not in the truth, or of which nothing is found."""


def trace(score: Float64, matched: Bool, truths: int, errors: Mapping[str, Float64]) -> Curve:
    """Compute the curve of one class from its predictions by falling confidence.

    Args:
        score: (P,) falling.
        matched: (P,) which are true positives.
        truths: number of true boxes.
        errors: (M,) each: of the true positives, by name; NaN: not defined for that pair.
    """
    if truths == 0 or not matched.any():
        return NO_MATCHES
    hits, misses = np.cumsum(matched).astype(np.float64), np.cumsum(~matched).astype(np.float64)
    recall = hits / float(truths)
    precision = np.interp(RECALL, recall, hits / (misses + hits), right=0)
    confidence = np.interp(RECALL, recall, score, right=0)
    # Read by confidence; the reversals are for interpolation, which wants rising abscissas.
    of_hits = score[matched][::-1]
    curves = {
        name: np.interp(confidence[::-1], of_hits, _running_mean(values)[::-1])[::-1] for name, values in errors.items()
    }
    return Curve(precision, confidence, curves)


def pair_errors(truth: DetectionBoxes, found: DetectionBoxes, period_rad: float) -> dict[str, Float64]:
    """Return the errors of pairs of boxes, row by row.

    Args:
        truth: M boxes.
        found: M boxes.
        period_rad: after which a heading is the same.

    Returns:
        (M,) each: ``trans_err`` in metres, ``scale_err`` as 1 - IoU of the boxes laid on each other, ``orient_err`` in
        radians, ``vel_err`` in m/s (NaN where a velocity is not known), ``attr_err`` 0 or 1 (NaN where the true box has
        no attribute).
    """
    shared, size, size2 = (_volume(lwh) for lwh in (np.minimum(truth.lwh_m, found.lwh_m), truth.lwh_m, found.lwh_m))
    turn = (truth.yaw_rad - found.yaw_rad + period_rad / 2) % period_rad - period_rad / 2
    turn = np.where(turn > np.pi, turn - 2 * np.pi, turn)
    other = np.where(truth.attribute == found.attribute, 0.0, 1.0)
    return {
        "trans_err": centre_distance(found.centre_m[:, :2], truth.centre_m[:, :2]),
        "scale_err": 1 - shared / (size + size2 - shared),
        "orient_err": np.abs(turn),
        "vel_err": centre_distance(found.velocity_mps, truth.velocity_mps),
        "attr_err": np.where(truth.attribute == "", np.nan, other),
    }


def _first(min_recall: float) -> int:
    """The first recall that counts: the one after the least."""
    return round(100 * min_recall) + 1


def _volume(lwh: Float64) -> Float64:
    return np.asarray(lwh[:, 0] * lwh[:, 1] * lwh[:, 2])


def _running_mean(values: Float64) -> AnyArray:
    """Means of the first 1, 2, ... numbers among values, 0 before the first number; ones if there is none."""
    numbers = ~np.isnan(values)
    if not numbers.any():
        return np.ones(len(values))
    count = np.cumsum(numbers)
    return np.divide(np.nancumsum(values), count, out=np.zeros(len(values)), where=count != 0)
