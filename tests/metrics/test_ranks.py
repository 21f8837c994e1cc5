"""Rank intervals against Tukey's range, against every resampling counted out, and by their invariances."""

from __future__ import annotations

import itertools
import math
import time
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.metrics.ranks import MIN_CLUSTERS, RankIntervals, rank_intervals
from tests.draws import draws

FAST = {"resamples": 400}


def white(methods: int, clusters: int) -> Float64:
    """Scores of mean 0 and variance 1 that no two methods share."""
    noise = np.random.default_rng(0).standard_normal((clusters, methods))
    basis, _ = np.linalg.qr(noise - noise.mean(axis=0))
    return (basis.T - basis.T.mean(axis=1, keepdims=True)) * math.sqrt(clusters - 1)


def shown(found: RankIntervals) -> list[str]:
    return [f"{rank} ({low}-{high})" for rank, low, high in zip(found.ranks, found.low, found.high)]


@pytest.mark.parametrize("methods", [2, 5, 12])
def test_the_largest_difference_of_independent_methods_has_tukey_s_quantile(methods: int) -> None:
    clusters = 200
    scores = white(methods, clusters)
    # The t of a difference of means is the range of two means over the square root of two.
    critical = stats.studentized_range.ppf(0.95, methods, clusters * (methods - 1)) / math.sqrt(2.0)
    step = math.sqrt(2.0 / clusters)
    lead = np.zeros((methods, 1))
    for factor, separated in ((0.93, 0), (1.07, methods - 1)):
        lead[0] = factor * critical * step
        found = rank_intervals(scores + lead, resamples=5000)
        assert found.is_better[0].sum() == separated
        assert found.is_better.sum() == separated


def test_decisions_of_few_clusters_are_those_of_all_resamplings() -> None:
    rng = np.random.default_rng(1)
    clusters, decided = 5, 0
    draws = np.array(list(itertools.product(range(clusters), repeat=clusters)))
    for scale in (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0):
        scores = rng.standard_normal((3, clusters)) + scale * np.arange(3)[:, None]
        pairs = list(itertools.permutations(range(3), 2))
        t, drawn = {}, {}
        for one, other in pairs:
            difference = scores[one] - scores[other]
            t[one, other] = min(stats.ttest_1samp(difference, 0.0).statistic, clusters)
            chosen = (difference - difference.mean())[draws]
            spread = np.maximum(chosen.std(axis=1, ddof=1), difference.std(ddof=1) / 3.0)
            drawn[one, other] = chosen.mean(axis=1) / (spread / 5**0.5)
        left, critical = set(pairs), math.inf
        while left:
            critical = np.quantile(np.max([drawn[pair] for pair in left], axis=0), 0.95, method="higher")
            rejected = {pair for pair in left if t[pair] > critical}
            if not rejected:
                break
            left -= rejected
        if any(abs(t[pair] - critical) < 0.1 * critical for pair in left):
            continue
        decided += 1
        found = rank_intervals(scores)
        assert {(int(a), int(b)) for a, b in np.argwhere(found.is_better)} == set(pairs) - left
    assert decided >= 4


def test_ranks_are_shared_by_runs_of_methods_that_are_not_separated() -> None:
    # Differences of 0.039 are separated: the third is separated from the first, and not from the second.
    scores = white(5, 100) * 0.1 + np.array([1.0, 0.98, 0.955, 0.5, 0.48])[:, None]
    expected = ["1 (1-2)", "1 (1-3)", "3 (2-3)", "4 (4-5)", "4 (4-5)"]
    assert shown(rank_intervals(scores)) == expected
    assert shown(rank_intervals(scores[::-1])) == expected[::-1]


def test_equal_methods_share_their_rank_and_all_places_of_it() -> None:
    scores = white(3, 20)[[0, 1, 1, 2]] * 0.1 + np.array([3.0, 2.0, 2.0, 1.0])[:, None]
    assert shown(rank_intervals(scores, **FAST)) == ["1 (1-1)", "2 (2-3)", "2 (2-3)", "4 (4-4)"]
    assert shown(rank_intervals(np.full((3, 9), 0.7), **FAST)) == ["1 (1-3)"] * 3


def test_equal_means_in_another_order_share_their_rank_without_intervals_too() -> None:
    found = rank_intervals([[0.1, 0.2, 0.3], [0.3, 0.1, 0.2], [0.0, 0.0, 0.0]])
    assert found.reason == f"3 of at least {MIN_CLUSTERS} clusters"
    assert shown(found) == ["1 (1-3)", "1 (1-3)", "3 (1-3)"]


def test_a_difference_that_every_cluster_has_tells_apart() -> None:
    scores = np.array([np.zeros(8), np.ones(8)])
    assert shown(rank_intervals(scores, **FAST)) == ["2 (2-2)", "1 (1-1)"]
    assert shown(rank_intervals(scores, better="lower", **FAST)) == ["1 (1-1)", "2 (2-2)"]


def test_clusters_without_a_score_are_left_out_for_all() -> None:
    scores = white(3, 30) * 0.1 + np.arange(3)[:, None]
    holed = scores.copy()
    holed[0, 3], holed[1, 7], holed[2, 9] = np.nan, np.inf, -np.inf
    found, expected = rank_intervals(holed), rank_intervals(np.delete(scores, [3, 7, 9], axis=1))
    assert (found.n_clusters, found.n_dropped) == (27, 3)
    assert shown(found) == shown(expected)


def test_items_are_averaged_within_their_cluster() -> None:
    rng = np.random.default_rng(3)
    items = rng.standard_normal((4, 12, 5)) + np.arange(4)[:, None, None]
    items[1, 2, :3] = np.nan
    items[0, 5] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        means = np.nanmean(items, axis=2)
    found, expected = rank_intervals(items, **FAST), rank_intervals(means, **FAST)
    assert shown(found) == shown(expected)
    assert found.n_dropped == 1


boards = st.integers(2, 6).flatmap(
    lambda methods: st.integers(0, 2**32 - 1).map(
        lambda seed: (
            np.round(np.random.default_rng(seed).normal(size=(methods, 12)), 1)
            + np.round(np.random.default_rng(seed + 1).normal(size=(methods, 1)) * 2)
        )
    )
)


@given(boards, st.randoms(use_true_random=False))
@settings(max_examples=draws(40), deadline=None)
def test_the_order_of_methods_shifts_of_clusters_and_the_scale_decide_nothing(scores: Float64, random: object) -> None:
    expected = rank_intervals(scores, **FAST)
    order = list(range(len(scores)))
    random.shuffle(order)
    shift = np.arange(scores.shape[1]) * 0.5
    changed = rank_intervals(4.0 * (scores[order] + shift), **FAST)
    assert shown(changed) == [shown(expected)[place] for place in order]
    mirrored = rank_intervals(-scores, better="lower", **FAST)
    assert shown(mirrored) == shown(expected)


@given(boards)
@settings(max_examples=draws(40), deadline=None)
def test_intervals_hold_their_ranks_and_decisions_are_an_order(scores: Float64) -> None:
    found = rank_intervals(scores, **FAST)
    assert np.all((found.low <= found.ranks) & (found.ranks <= found.high))
    means = scores.mean(axis=1)
    one, other = np.nonzero(found.is_better)
    assert np.all(means[one] > means[other])
    doubled = rank_intervals(np.repeat(scores, 2, axis=0), **FAST)
    assert np.array_equal(doubled.ranks[::2], doubled.ranks[1::2])
    assert np.array_equal(doubled.high[::2], doubled.high[1::2])


def test_a_difference_that_one_cluster_lacks_hides_no_other() -> None:
    """A third of the draws misses the ninth cluster, and has no error of its own."""
    constant = np.full(10, 0.7)
    scores = np.array([constant, 0.02 * np.eye(10)[8], 0.4 + 0.1 * white(1, 10)[0]])
    assert shown(rank_intervals(scores)) == ["1 (1-1)", "3 (3-3)", "2 (2-2)"]


def test_a_hidden_offset_costs_nothing() -> None:
    scores = white(4, 25) * 0.1 + np.array([0.0, 0.3, 0.31, 1.0])[:, None]
    assert shown(rank_intervals(scores + 1e6)) == shown(rank_intervals(scores))


def test_twelve_methods_take_less_than_a_second() -> None:
    scores = white(12, 40) + np.linspace(0, 2, 12)[:, None]
    started = time.thread_time()
    rank_intervals(scores)
    assert time.thread_time() - started < 1.0


@pytest.mark.parametrize(
    ("scores", "options"),
    [
        ([1.0, 2.0], {}),
        (np.zeros((0, 5)), {}),
        (np.zeros((2, 5)), {"better": "none"}),
        (np.zeros((2, 5)), {"confidence": 95}),
        (np.zeros((2, 5)), {"resamples": 0}),
    ],
)
def test_what_has_no_meaning_is_refused(scores: object, options: dict[str, object]) -> None:
    with pytest.raises(UsageError):
        rank_intervals(scores, **options)
