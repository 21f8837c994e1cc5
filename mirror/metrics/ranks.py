"""How sure a rank is: simultaneous confidence intervals of the ranks of several methods on the same clusters.

A cluster is what differs from one repetition of the benchmark to the next as a whole: a scene, or a scenario on a
street. Ranks follow from differences: a method is ranked behind those that are separated from it as better. All
differences are judged at once (Mogstad, Romano, Shaikh, Wilhelm: Inference for ranks, 2024), by the largest
studentised difference of any two methods under resampling of clusters (max-t), stepwise (Romano, Wolf 2005): with the
stated confidence no difference is judged the wrong way round and no tie is broken, so that all intervals hold all true
ranks at once. Methods that are equal in truth have all the ranks of their tie.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import UsageError
from mirror.metrics.images.bootstrap import CONFIDENCE, RESAMPLES
from mirror.metrics.inputs import Numbers, as_numbers

MIN_CLUSTERS: Final = 5

_ROUNDING: Final = 1e-12
"""Differences below this share of the largest score are rounding."""
_LEAST_ERROR: Final = 1.0 / 3.0
"""Least standard error of a draw, as a share of the sample's. Draws that miss the only cluster that differs have none
of their own, and one such pair would else hide the differences of all."""
_CHUNK: Final = 1 << 20


@dataclass(frozen=True, eq=False)
class RankIntervals:
    """Ranks of M methods with their confidence intervals; 1 is the best.

    Attributes:
        ranks: (M,) ranks. Methods that follow each other in the order of their means, no two of which are separated,
            share the first place of them; so do methods of equal means. Without intervals: places, shared by equal
            means alone.
        low: (M,) best rank that a method can have: one more than the methods that are separated from it as better.
        high: (M,) worst rank that it can have: M less the methods that are separated from it as worse.
        is_better: (M, M) whether the method of the row is separated from that of the column as better.
        n_clusters: clusters with a finite score of every method.
        n_dropped: clusters without.
        reason: why no method is separated from another; None: they were compared.
    """

    ranks: Int64
    low: Int64
    high: Int64
    is_better: Bool
    n_clusters: int
    n_dropped: int
    reason: str | None


def rank_intervals(
    scores: Numbers,
    *,
    better: Literal["higher", "lower"] = "higher",
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> RankIntervals:
    """Compute the ranks of methods by their means over clusters, with simultaneous intervals of the ranks.

    A difference that is the same in all C clusters counts as if one further cluster had shown none: its t is C, and no
    t is larger. What no cluster shows, such as a rare failure that nobody had yet, no interval knows.

    Args:
        scores: (M, C) scores of M methods in C clusters, or (M, C, N) of N items in each, which are averaged within
            their cluster. Items that are not finite are left out, and so are clusters in which a method has no finite
            score, for all methods.
        better: direction of the scores.
        confidence: probability that all intervals hold all true ranks, in (0, 1).
        resamples: number of resamplings of the clusters.
        seed: of the resampling; equal arguments give equal results.

    Returns:
        The ranks; intervals of all ranks, and a reason, with fewer than `MIN_CLUSTERS` clusters.

    Raises:
        UsageError: the scores have another shape or no method, or an option is out of its range.
    """
    means = _cluster_means(as_numbers(scores, "scores", np.float64))
    if better not in ("higher", "lower") or not 0.0 < confidence < 1.0 or resamples < 1:
        raise UsageError(
            f"better {better!r}, confidence {confidence}, {resamples} resamples",
            expected="higher or lower, a confidence between 0 and 1, at least one resampling",
        )
    whole = np.isfinite(means).all(axis=0)
    kept = means[:, whole] if better == "higher" else -means[:, whole]
    methods, clusters = kept.shape
    # Equal scores in another order of clusters have equal means.
    totals = np.array([math.fsum(row) / max(clusters, 1) for row in kept])
    tolerance = _ROUNDING * float(np.abs(kept).max(initial=0.0))
    is_better = np.zeros((methods, methods), bool)
    reason = None
    if clusters < MIN_CLUSTERS:
        reason = f"{clusters} of at least {MIN_CLUSTERS} clusters"
    else:
        first, second = np.triu_indices(methods, 1)
        ahead, behind = _judge_differences(kept[first] - kept[second], tolerance, confidence, resamples, seed)
        is_better[first, second], is_better[second, first] = ahead, behind
    return RankIntervals(
        ranks=_share_ranks(totals, is_better, tolerance, alone=reason is not None),
        low=1 + is_better.sum(axis=0),
        high=methods - is_better.sum(axis=1),
        is_better=is_better,
        n_clusters=clusters,
        n_dropped=int((~whole).sum()),
        reason=reason,
    )


def _cluster_means(scores: Float64) -> Float64:
    if scores.ndim not in (2, 3) or not scores.shape[0]:
        raise UsageError(
            f"scores of shape {scores.shape}", expected="scores of methods x clusters, or methods x clusters x items"
        )
    if scores.ndim == 2:
        return scores
    finite = np.isfinite(scores)
    counts = finite.sum(axis=2)
    sums = np.where(finite, scores, 0.0).sum(axis=2)
    return np.where(counts, sums / np.maximum(counts, 1), np.nan)


def _judge_differences(
    differences: Float64, tolerance: float, confidence: float, resamples: int, seed: int
) -> tuple[Bool, Bool]:
    """Judge differences (P, C) of pairs in C clusters: which are above 0 (P,), and which below (P,).

    Each pair is tested in both directions. What is decided is left out of the next step's largest t.
    """
    clusters = differences.shape[1]
    mean = differences.mean(axis=1)
    centred = differences - mean[:, None]
    observed = np.clip(_studentise(differences.T, np.ones((1, clusters)), tolerance)[0], -clusters, clusters)
    open_above, open_below = np.ones(len(mean), bool), np.ones(len(mean), bool)
    # The quantile that counts the observed one among the draws.
    place = math.ceil((resamples + 1) * confidence) - 1
    while open_above.any() or open_below.any():
        largest = _draw_largest(centred.T, open_above, open_below, tolerance, resamples, seed)
        critical = math.inf if place >= resamples else float(np.partition(largest, place)[place])
        above, below = open_above & (observed > critical), open_below & (-observed > critical)
        if not above.any() and not below.any():
            break
        open_above &= ~above
        open_below &= ~below
    return ~open_above, ~open_below


def _draw_largest(
    centred: Float64, open_above: Bool, open_below: Bool, tolerance: float, resamples: int, seed: int
) -> Float64:
    """Draw the largest t (B,) of undecided pairs from centred differences (C, P), the same draws in each step."""
    rng = np.random.default_rng(seed)
    clusters = len(centred)
    used = open_above | open_below
    above, below = open_above[used], open_below[used]
    columns = np.ascontiguousarray(centred[:, used])
    # Of the size that all pairs need, so that each step draws alike.
    step = max(1, _CHUNK // max(centred.shape))
    parts = []
    for start in range(0, resamples, step):
        rows = min(step, resamples - start)
        chosen = rng.integers(clusters, size=(rows, clusters)) + clusters * np.arange(rows)[:, None]
        counts = np.bincount(chosen.ravel(), minlength=rows * clusters).reshape(rows, clusters).astype(np.float64)
        t = _studentise(columns, counts, tolerance)
        parts.append(
            np.maximum(
                np.max(t, axis=1, where=above, initial=-np.inf), np.max(-t, axis=1, where=below, initial=-np.inf)
            )
        )
    return np.concatenate(parts)


def _studentise(values: Float64, counts: Float64, tolerance: float) -> Float64:
    """Return t (B, P) of the mean of values (C, P), each drawn as often as counts (B, C) say; 0 for a mean of 0."""
    clusters = len(values)
    means = counts @ values / clusters
    variances = (counts @ values**2 / clusters - means**2) * (clusters / (clusters - 1))
    least = _LEAST_ERROR * values.std(axis=0, ddof=1)
    errors = np.maximum(np.sqrt(np.maximum(variances, 0.0)), least) / math.sqrt(clusters)
    is_zero = np.abs(means) <= tolerance
    # Equal differences in all clusters have no error: as far from 0 as can be.
    constant = errors <= np.maximum(tolerance, _ROUNDING * np.abs(means))
    t = np.where(constant, np.copysign(np.inf, means), means / np.where(constant, 1.0, errors))
    return np.where(is_zero, 0.0, t)


def _share_ranks(totals: Float64, is_better: Bool, tolerance: float, *, alone: bool) -> Int64:
    """Return the ranks (M,): each method joins those before it if it is separated from none of them."""
    order = np.argsort(-totals, kind="stable")
    ties = np.split(order, 1 + np.flatnonzero(totals[order][:-1] - totals[order][1:] > tolerance))
    ranks = np.zeros(len(totals), np.int64)
    shared: list[int] = []
    place = 1
    for tie in ties:
        if alone or is_better[shared][:, tie].any():
            shared = []
        first = int(ranks[shared[0]]) if shared else place
        ranks[tie] = first
        shared.extend(tie.tolist())
        place += len(tie)
    return ranks
