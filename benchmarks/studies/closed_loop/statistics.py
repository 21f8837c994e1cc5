"""Whether the verdicts of two worlds agree: rank correlation of policies, balanced accuracy, differences of figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import kendalltau

from mirror.arrays import Bool, Float64


@dataclass(frozen=True, eq=False)
class Rollouts:
    """Rollouts of P policies in S scenarios with K seeds, in one world.

    Attributes:
        score: (P, S, K) scores.
        collision: (P, S, K) verdicts.
        off_road: (P, S, K) verdicts.
        least_ttc_s: (P, S, K) least times to collision.
        offset_m: (P, S, K) mean perceived less exact offset.
        lead_m: (P, S, K) mean perceived less exact distance of the lead; NaN without a lead.
    """

    score: Float64
    collision: Bool
    off_road: Bool
    least_ttc_s: Float64
    offset_m: Float64
    lead_m: Float64

    def of(self, scenarios: Any) -> Rollouts:
        """Return the rollouts in some scenarios."""
        return Rollouts(**{name: values[:, scenarios] for name, values in vars(self).items()})


def rank_correlation(first: Rollouts, second: Rollouts) -> float:
    """Return Kendall's tau-b of the policies' mean scores; NaN if all policies of a world have the same score."""
    return float(kendalltau(*(one.score.mean(axis=(1, 2)) for one in (first, second)), variant="b").statistic)


def balanced_accuracy(true: Bool, found: Bool) -> float:
    """Compute the mean of two shares: of true and of false verdicts that are found to be so.

    NaN if all true verdicts are the same.
    """
    flat, other = np.ravel(true), np.ravel(found)
    if flat.all() or not flat.any():
        return float("nan")
    return float(0.5 * (other[flat].mean() + (~other[~flat]).mean()))


def mean_difference(true: Float64, found: Float64, *, absolute: bool = False) -> float:
    """Return the mean of found less true, or of its magnitude, where both have a value; NaN if that is nowhere."""
    difference = (found - true)[np.isfinite(found) & np.isfinite(true)]
    if not len(difference):
        return float("nan")
    return float((np.abs(difference) if absolute else difference).mean())


def compare(true: Rollouts, found: Rollouts) -> dict[str, float]:
    """Return all figures of a world against the exact one."""
    return {
        "tau": rank_correlation(true, found),
        "collision": balanced_accuracy(true.collision, found.collision),
        "off_road": balanced_accuracy(true.off_road, found.off_road),
        "ttc_s": mean_difference(true.least_ttc_s, found.least_ttc_s),
        "ttc_abs_s": mean_difference(true.least_ttc_s, found.least_ttc_s, absolute=True),
        "offset_m": mean_difference(true.offset_m, found.offset_m),
        "offset_abs_m": mean_difference(true.offset_m, found.offset_m, absolute=True),
        "lead_m": mean_difference(true.lead_m, found.lead_m),
        "lead_abs_m": mean_difference(true.lead_m, found.lead_m, absolute=True),
    }


def intervals(
    true: Rollouts, found: Rollouts, resamples: int, level: float, seed: int = 0
) -> Mapping[str, tuple[float, float]]:
    """Return the intervals of all figures; scenarios are drawn with replacement, with all their seeds and policies."""
    rng = np.random.default_rng(seed)
    count = true.score.shape[1]
    drawn = []
    for _ in range(resamples):
        rows = rng.integers(count, size=count)
        drawn.append(compare(true.of(rows), found.of(rows)))
    tail = 0.5 * (1.0 - level)
    found_ends = {}
    for name in drawn[0]:
        values = np.array([one[name] for one in drawn])
        values = values[np.isfinite(values)]
        ends = np.quantile(values, [tail, 1.0 - tail]) if len(values) else np.full(2, np.nan)
        found_ends[name] = (float(ends[0]), float(ends[1]))
    return found_ends
