import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.metrics.features.statistics import FeatureAccumulator, FeatureStatistics
from tests.draws import draws


def features(n, d, seed=0, offset=0.0):
    return np.random.default_rng(seed).standard_normal((n, d)) + offset


def exact_covariance(values):
    """Longdouble, two passes."""
    wide = values.astype(np.longdouble)
    centred = wide - wide.mean(axis=0)
    return (centred.T @ centred / (len(values) - 1)).astype(np.float64)


@pytest.mark.parametrize("n", [5, 40, 3000])
def test_covariance_is_numpys(n):
    x = features(n, 40)
    np.testing.assert_allclose(FeatureStatistics.from_features(x).covariance(), np.cov(x.T), atol=1e-13)
    np.testing.assert_allclose(FeatureStatistics.from_features(x).covariance(0), np.cov(x.T, ddof=0), atol=1e-13)


@pytest.mark.parametrize(("offset", "bar"), [(1e4, 1e-11), (1e6, 1e-10), (1e8, 1e-8)])
@pytest.mark.parametrize("n", [20, 5000])
def test_offsets_cost_nothing(offset, bar, n):
    x = features(n, 24, offset=offset)
    truth = exact_covariance(x)
    stream = FeatureAccumulator()
    for part in np.array_split(x, 7):
        stream.update(part)
    assert np.abs(FeatureStatistics.from_features(x).covariance() - truth).max() < min(bar, 1e-11)
    assert np.abs(stream.compute().covariance() - truth).max() < bar


@settings(max_examples=draws(40), deadline=None)
@given(sizes=st.lists(st.integers(1, 9), min_size=1, max_size=8), d=st.integers(1, 20), seed=st.integers(0, 99))
def test_any_batches_give_the_same(sizes, d, seed):
    x = features(sum(sizes), d, seed, offset=3.0)
    stream, other = FeatureAccumulator(), FeatureAccumulator()
    merged = None
    start = 0
    for number, size in enumerate(sizes):
        part = x[start : start + size]
        (stream if number % 2 else other).update(part)
        one = FeatureStatistics.from_features(part)
        merged = one if merged is None else merged.merge(one)
        start += size
    stream.merge(other)
    whole = FeatureStatistics.from_features(x)
    for got in (stream.compute(), merged):
        assert got.count == whole.count
        np.testing.assert_allclose(got.mean, whole.mean, atol=1e-12)
        np.testing.assert_allclose(got.covariance(0), whole.covariance(0), atol=1e-12)
    assert (merged.rows is None) == (whole.rows is None)


def test_accumulator_holds_few_rows():
    stream = FeatureAccumulator()
    x = features(20000, 4)
    for part in np.array_split(x, 30):
        stream.update(part)
        assert sum(map(len, stream.pending)) <= 2048
    np.testing.assert_allclose(stream.compute().covariance(), np.cov(x.T), atol=1e-13)


def test_batches_are_copied():
    stream, batch = FeatureAccumulator(), features(3, 4)
    stream.update(batch)
    kept = stream.compute().mean.copy()
    batch[:] = 0.0
    np.testing.assert_array_equal(stream.compute().mean, kept)


def test_moments_of_other_tools():
    x = features(50, 6)
    got = FeatureStatistics.from_moments(x.mean(axis=0), np.cov(x.T), 50)
    np.testing.assert_allclose(got.covariance(), np.cov(x.T), rtol=1e-14)


@pytest.mark.parametrize(
    "bad",
    [
        np.zeros(3),
        np.zeros((0, 3)),
        np.zeros((3, 0)),
        np.array([[1.0, np.nan]]),
        np.array([[1.0, np.inf]]),
        np.zeros((2, 2), complex),
    ],
)
def test_bad_features(bad):
    with pytest.raises(UsageError):
        FeatureStatistics.from_features(bad)


def test_bad_calls():
    one = FeatureStatistics.from_features(np.ones((1, 3)))
    assert one.covariance(0).max() == 0.0
    with pytest.raises(UsageError, match="no covariance"):
        one.covariance()
    with pytest.raises(UsageError, match="ddof"):
        one.covariance(2)
    with pytest.raises(UsageError, match="cannot be merged"):
        one.merge(FeatureStatistics.from_features(np.ones((1, 4))))
    with pytest.raises(UsageError, match="never both"):
        FeatureStatistics(1, np.zeros(2))
    with pytest.raises(UsageError, match="no features"):
        FeatureAccumulator().compute()
    stream = FeatureAccumulator()
    stream.update(np.ones((1, 3)))
    with pytest.raises(UsageError, match="after batches"):
        stream.update(np.ones((1, 4)))
    for mean, covariance, count in (
        (np.zeros(2), np.zeros((3, 3)), 5),
        (np.zeros(2), np.array([[1.0, 0.5], [0.0, 1.0]]), 5),
        (np.zeros(2), np.full((2, 2), np.nan), 5),
        (np.zeros(2), np.eye(2), 1),
    ):
        with pytest.raises(UsageError):
            FeatureStatistics.from_moments(mean, covariance, count)
