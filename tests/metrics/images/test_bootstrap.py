import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from mirror.errors import UsageError
from mirror.metrics.images.bootstrap import frame_blocks, mean_interval, paired_difference


def walk(rng, frames, hold):
    """Scores that stay alike for some frames."""
    return np.repeat(rng.standard_normal(frames // hold), hold)


@pytest.mark.parametrize(("method", "theirs"), [("bca", "BCa"), ("percentile", "percentile")])
def test_intervals_are_scipy_s_when_every_image_is_a_block(method, theirs):
    scores = np.random.default_rng(0).exponential(size=80)
    found = mean_interval(scores, range(80), method=method, resamples=40_000)
    options = {"method": theirs, "n_resamples": 40_000, "rng": np.random.default_rng(1)}
    expected = stats.bootstrap((scores,), np.mean, **options).confidence_interval
    assert (found.low, found.high) == pytest.approx(expected, abs=0.01)
    assert found.mean == pytest.approx(scores.mean(), abs=1e-15)


def test_few_blocks_give_the_distribution_that_can_be_counted_out():
    # Two blocks: means of (a, a), (a, b), (b, a), (b, b) are drawn equally often.
    found = mean_interval([1.0, 3.0, 10.0], [0, 0, 1], method="percentile", confidence=0.9, resamples=20_000)
    assert (found.low, found.high) == (2.0, 10.0)
    middle = mean_interval([1.0, 3.0, 10.0], [0, 0, 1], method="percentile", confidence=0.4, resamples=20_000)
    assert (middle.low, middle.high) == pytest.approx((14 / 3, 14 / 3))


def test_blocks_hold_what_single_images_do_not():
    rng = np.random.default_rng(0)
    held = {"single": 0, "blocks": 0}
    for trial in range(150):
        scores = walk(rng, 400, 10)
        for how, blocks in (("single", range(400)), ("blocks", frame_blocks(["a"] * 400, range(400), 20))):
            interval = mean_interval(scores, blocks, resamples=500, seed=trial)
            held[how] += interval.low <= 0.0 <= interval.high
    assert held["blocks"] / 150 > 0.85
    assert held["single"] / 150 < 0.6


def test_draws_of_many_blocks_take_little_memory():
    scores = np.random.default_rng(0).random(5000)
    tracemalloc.start()
    mean_interval(scores, range(5000), resamples=3000)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # All 15 million draws at once would be 120 MB of numbers and twice as much of scores and counts.
    assert peak < 60e6


def test_results_are_repeatable():
    scores, blocks = np.random.default_rng(0).random(50), np.arange(50) // 5
    assert mean_interval(scores, blocks, seed=3) == mean_interval(scores, blocks, seed=3)
    assert mean_interval(scores, blocks, seed=3) != mean_interval(scores, blocks, seed=4)


def test_scores_that_are_not_finite_are_dropped_and_counted():
    scores = [1.0, math.inf, 2.0, math.nan, 4.0, 5.0]
    found = mean_interval(scores, [0, 0, 1, 1, 2, 3])
    plain = mean_interval([1.0, 2.0, 4.0, 5.0], [0, 1, 2, 3])
    assert (found.n, found.n_dropped, found.n_blocks) == (4, 2, 4)
    assert (found.low, found.high, found.mean) == (plain.low, plain.high, plain.mean)


@pytest.mark.parametrize("scores", [[], [1.0], [1.0, 2.0], [math.nan, math.inf]])
def test_fewer_than_two_blocks_give_a_reason(scores):
    found = mean_interval(scores, [0] * len(scores))
    assert math.isnan(found.low)
    assert math.isnan(found.high)
    assert found.reason == "fewer than two blocks of finite scores"
    assert math.isnan(paired_difference(scores, scores, [0] * len(scores)).p_value)


@pytest.mark.parametrize("method", ["bca", "percentile"])
@pytest.mark.parametrize("value", [0.1, -7.3, 1e8])
def test_equal_scores_have_an_interval_of_one_point(method, value):
    found = mean_interval([value] * 30, np.arange(30) // 3, method=method)
    assert (found.low, found.high) == pytest.approx((value, value), rel=1e-15)


def test_an_offset_moves_the_interval_and_nothing_else():
    scores, blocks = np.rint(np.random.default_rng(0).random(60) * 1024) / 1024, np.arange(60) // 4
    # BCa counts draws that tie with the mean by half, and rounding breaks ties.
    for method, error in (("percentile", 1e-7), ("bca", 1e-4)):
        near, far = (mean_interval(scores + offset, blocks, method=method) for offset in (0.0, 1e8))
        assert (far.low - 1e8, far.high - 1e8) == pytest.approx((near.low, near.high), abs=error)


@pytest.mark.parametrize("outlier", [1e3, -1e3])
def test_one_block_far_off_the_others(outlier):
    scores = np.zeros(2000)
    scores[0] = outlier
    found = mean_interval(scores, np.arange(2000), resamples=2000)
    assert min(outlier, 0) <= found.low <= found.high <= max(outlier, 0)


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=30), st.integers(0, 5))
def test_intervals_are_ordered_and_inside_the_scores(scores, seed):
    found = mean_interval(scores, range(len(scores)), resamples=200, seed=seed)
    slack = 1e-9 * (1 + max(map(abs, scores)))
    assert min(scores) - slack <= found.low <= found.high <= max(scores) + slack


def test_frames_make_blocks_within_sequences():
    sequences = ["a", "b", "a", "a", "b", "a", "a"]
    frames = [30, 5, 10, 10, 7, 20, 40]
    assert frame_blocks(sequences, frames, 2).tolist() == [1, 2, 0, 0, 2, 0, 1]
    assert frame_blocks([], [], 2).tolist() == []
    with pytest.raises(UsageError, match="blocks of 0"):
        frame_blocks(sequences, frames, 0)
    with pytest.raises(UsageError, match="7 sequences"):
        frame_blocks(sequences, frames[:3], 2)


def test_the_p_value_counts_flips_of_blocks():
    # |±1 ±2 ±3| >= 6: two of eight; as a sum, since both images of a block keep one sign.
    found = paired_difference([2.0, 3.0, 4.5, 3.5], [1.0, 1.0, 2.0, 3.0], [0, 1, 2, 2])
    assert found.p_value == 2 / 8
    assert found.interval.mean == pytest.approx(6 / 4)
    swapped = paired_difference([1.0, 1.0, 2.0, 3.0], [2.0, 3.0, 4.5, 3.5], [0, 1, 2, 2])
    assert swapped.p_value == found.p_value
    assert swapped.interval.mean == -found.interval.mean


def test_the_p_value_of_many_blocks_is_scipy_s():
    rng = np.random.default_rng(0)
    first = rng.standard_normal(40)
    second = first - 0.1 + 0.4 * rng.standard_normal(40)
    found = paired_difference(first, second, range(40), resamples=20_000)
    options = {"permutation_type": "samples", "n_resamples": 20_000, "rng": np.random.default_rng(1)}
    expected = stats.permutation_test((first, second), lambda a, b: np.mean(a - b), **options).pvalue
    assert found.p_value == pytest.approx(expected, abs=0.02)


def test_equal_methods_do_not_differ():
    scores = np.random.default_rng(0).random(40)
    found = paired_difference(scores, scores, np.arange(40) // 2)
    assert found.p_value == 1.0
    assert (found.interval.low, found.interval.high) == (0.0, 0.0)


def test_pairs_with_an_infinite_score_are_dropped():
    found = paired_difference([math.inf, 2.0, 3.0, 4.0], [math.inf, 1.0, math.nan, 2.0], range(4))
    assert (found.interval.n, found.interval.n_dropped) == (2, 2)
    assert found.interval.mean == 1.5


def test_p_values_are_uniform_when_nothing_differs():
    rng = np.random.default_rng(0)
    values = [
        paired_difference(walk(rng, 60, 3), walk(rng, 60, 3), np.arange(60) // 3, resamples=300).p_value
        for _ in range(200)
    ]
    assert np.mean(np.array(values) <= 0.1) == pytest.approx(0.1, abs=0.07)


@pytest.mark.parametrize(
    ("scores", "blocks", "options"),
    [
        ([1.0, 2.0], [0], {}),
        ([[1.0]], [[0]], {}),
        ([1.0, 2.0], [0.5, 1.5], {}),
        ([1.0, 2.0], [0, 1], {"method": "basic"}),
        ([1.0, 2.0], [0, 1], {"confidence": 95}),
        ([1.0, 2.0], [0, 1], {"resamples": 0}),
    ],
)
def test_what_has_no_meaning_is_refused(scores, blocks, options):
    with pytest.raises(UsageError):
        mean_interval(scores, blocks, **options)


def test_methods_are_compared_on_the_same_images():
    with pytest.raises(UsageError, match="the same images"):
        paired_difference([1.0], [1.0, 2.0], [0, 1])


def test_blocks_of_one_frame() -> None:
    assert frame_blocks(["a", "a", "b", "a"], np.array([3, 1, 2, 3]), 1).tolist() == [1, 0, 2, 1]
    with pytest.raises(UsageError, match="length > 0"):
        frame_blocks(["a"], np.array([0]), 0)


def test_the_skewness_of_blocks_of_unequal_size_is_that_of_the_jackknife_of_their_means() -> None:
    """Quantiles of BCa by its definition (Efron 1987), with the mean left out block by block."""
    rng = np.random.default_rng(0)
    counts = np.append(rng.integers(1, 4, 9), 400)
    blocks = np.repeat(np.arange(10), counts)
    scores = np.where(blocks == 9, 0.0, rng.exponential(5.0, len(blocks)))
    options = {"resamples": 60_000, "confidence": 0.9}
    found = mean_interval(scores, blocks, **options)
    left = np.array([scores[blocks != block].mean() for block in range(10)])
    skew = left.mean() - left
    acceleration = (skew**3).sum() / (6.0 * (skew**2).sum() ** 1.5)
    draws = np.random.default_rng(1).integers(0, 10, (60_000, 10))
    sums = np.bincount(blocks, scores)
    means = sums[draws].sum(axis=1) / counts[draws].sum(axis=1)
    bias = stats.norm.ppf((means < scores.mean()).mean())
    ends = [stats.norm.cdf(bias + (bias + z) / (1 - acceleration * (bias + z))) for z in stats.norm.ppf([0.05, 0.95])]
    assert (found.low, found.high) == pytest.approx(np.quantile(means, ends), rel=0.05)
