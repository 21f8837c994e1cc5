"""Fréchet distances of rollouts, and intervals of their ratios from a bootstrap over drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from benchmarks.studies.generation.scoring import Scores
from mirror.arrays import Int64
from mirror.metrics.features.frechet import frechet_distance
from mirror.metrics.features.statistics import FeatureStatistics

Statistics = Mapping[str, FeatureStatistics]
"""Statistics of features by drive."""


@dataclass(frozen=True)
class Ratio:
    """A ratio of two distances to the same truth.

    Attributes:
        value: of all drives.
        low: lower end of its interval.
        high: upper end of its interval.
        distances: both distances; means over the seeds.
        n: number of features of the truth.
    """

    value: float
    low: float
    high: float
    distances: tuple[float, float]
    n: int


def collect_statistics(scores: Mapping[str, Scores], drives: Mapping[str, str], name: str) -> Statistics:
    """Return the statistics of features by drive.

    Args:
        scores: by clip.
        drives: drive of each clip.
        name: of the features: image, motion or crop.
    """
    rows: dict[str, list[np.ndarray]] = {}
    for clip, one in scores.items():
        if len(one[name]):
            rows.setdefault(drives[clip], []).append(one[name])
    return {drive: FeatureStatistics.from_features(np.concatenate(parts)) for drive, parts in rows.items()}


def measure_distance(model: Statistics, truth: Statistics) -> float:
    """Return the Fréchet distance of a model to the truth, over all drives."""
    drives = sorted(truth)
    everyone = np.arange(len(drives))
    return frechet_distance(_merge(model, drives, everyone), _merge(truth, drives, everyone)).value


def compare(
    first: Sequence[Statistics],
    second: Sequence[Statistics],
    truth: Statistics,
    *,
    resamples: int,
    level: float,
    seed: int = 0,
) -> Ratio:
    """Compare the distances of two models to the truth; drives are resampled, in both models alike.

    Args:
        first: statistics of the first model, one entry for each seed of its training.
        second: those of the second model. Ratios are taken seed by seed and averaged.
        truth: statistics of the truth.
        resamples: number of draws of drives.
        level: probability that the interval is to hold the ratio.
        seed: of the draws.
    """
    drives = sorted(truth)
    rng = np.random.default_rng(seed)
    everyone = np.arange(len(drives))
    value = _mean_ratio(first, second, truth, drives, everyone)
    draws = [rng.integers(len(drives), size=len(drives)) for _ in range(resamples)]
    drawn = [_mean_ratio(first, second, truth, drives, rows)[0] for rows in draws]
    low, high = np.quantile(drawn, [0.5 * (1.0 - level), 0.5 * (1.0 + level)]) if drawn else (np.nan, np.nan)
    return Ratio(value[0], float(low), float(high), value[1], sum(one.count for one in truth.values()))


def _mean_ratio(
    first: Sequence[Statistics], second: Sequence[Statistics], truth: Statistics, drives: Sequence[str], rows: Int64
) -> tuple[float, tuple[float, float]]:
    target = _merge(truth, drives, rows)
    distances = np.array(
        [
            [frechet_distance(_merge(model, drives, rows), target).value for model in (one, other)]
            for one, other in zip(first, second, strict=True)
        ]
    )
    means = distances.mean(axis=0)
    return float((distances[:, 0] / distances[:, 1]).mean()), (float(means[0]), float(means[1]))


def _merge(statistics: Statistics, drives: Sequence[str], rows: Int64) -> FeatureStatistics:
    return reduce(FeatureStatistics.merge, [statistics[drives[row]] for row in rows if drives[row] in statistics])
