"""Which predictions are near which true boxes, once; and who gets whom, at every threshold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirror.arrays import AnyArray, Float64, Int64
from mirror.metrics.detection.boxes import DetectionBoxes, category_codes
from mirror.metrics.detection.config import DetectionConfig

_PAIRS_AT_ONCE = 1 << 22


@dataclass(frozen=True, eq=False)
class MatchingTable:
    """One class's predictions by falling confidence, with the true boxes of their sample within reach.

    Attributes:
        predictions: (P,) rows of the predictions; of equal scores the later row comes first, as in nuScenes.
        truths: number of true boxes of the class.
        first: (P + 1,) where each prediction's candidates begin.
        truth: (K,) rows of the candidates, ascending within a prediction.
        distance_m: (K,) distance of the centres along the ground.
    """

    predictions: Int64
    truths: int
    first: Int64
    truth: Int64
    distance_m: Float64

    def assign(self, thresholds_m: Float64, rows: int) -> Int64:
        """Return the true boxes' rows (T, P) that predictions get at each threshold, -1 for none.

        Args:
            thresholds_m: (T,).
            rows: number of true boxes of all classes.
        """
        from mirror.metrics.detection.matching_kernels import assign

        return np.asarray(assign(self.first, self.truth, self.distance_m, thresholds_m, rows))


def matching_tables(
    truth: DetectionBoxes, predictions: DetectionBoxes, config: DetectionConfig
) -> dict[str, MatchingTable]:
    """Return the table of every class.

    Args:
        truth: true boxes of all samples.
        predictions: predicted ones.
        config: the classes, and the largest distance that can match.

    Raises:
        UsageError: a category is not among the classes; its row is named.
    """
    samples, sample = np.unique(np.concatenate((truth.sample, predictions.sample)), return_inverse=True)
    sample = sample.reshape(-1)
    truth_codes, codes = category_codes(truth, config), category_codes(predictions, config)
    # Rows of true boxes by class and sample, in their own order within.
    key = truth_codes * len(samples) + sample[: len(truth)]
    order = np.argsort(key, kind="stable")
    ranked = np.argsort(predictions.score, kind="stable")[::-1]
    wanted = codes[ranked] * len(samples) + sample[len(truth) :][ranked]
    begin, end = (np.searchsorted(key[order], wanted, side=side) for side in ("left", "right"))
    tables = {}
    for code, name in enumerate(config.class_range):
        chosen = np.flatnonzero(codes[ranked] == code)
        rows = ranked[chosen]
        near = _near(truth, predictions, order, rows, begin[chosen], end[chosen], max(config.dist_ths))
        tables[name] = MatchingTable(rows, int(np.count_nonzero(truth_codes == code)), *near)
    return tables


def centre_distance(one: Float64, other: Float64) -> Float64:
    """Compute the lengths (N,) of the differences of vectors (N, 2).

    They are rounded as ``numpy.linalg.norm`` rounds those of single vectors.
    """
    difference = one - other
    return np.asarray(np.sqrt(np.vecdot(difference, difference)))


def _near(
    truth: DetectionBoxes,
    predictions: DetectionBoxes,
    order: AnyArray,
    rows: AnyArray,
    begin: AnyArray,
    end: AnyArray,
    limit: float,
) -> tuple[Int64, Int64, Float64]:
    """First candidates, candidates and distances of predictions whose sample's true boxes are ``order[begin:end]``."""
    number = end - begin
    counts = np.zeros(len(rows), dtype=np.int64)
    candidates, distances = [np.empty(0, dtype=np.int64)], [np.empty(0)]
    part = np.cumsum(number) // _PAIRS_AT_ONCE
    for block in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(part)) + 1):
        size = number[block]
        prediction = np.repeat(block, size)
        place = np.arange(len(prediction)) - np.repeat(np.cumsum(size) - size, size) + begin[prediction]
        candidate = order[place]
        distance = centre_distance(predictions.centre_m[rows[prediction], :2], truth.centre_m[candidate, :2])
        close = distance < limit
        counts += np.bincount(prediction[close], minlength=len(rows))
        candidates.append(candidate[close])
        distances.append(distance[close])
    return np.concatenate(([0], np.cumsum(counts))), np.concatenate(candidates), np.concatenate(distances)
