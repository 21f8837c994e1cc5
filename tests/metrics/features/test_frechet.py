"""Fréchet distances against closed forms.

Between X and X T with T symmetric positive definite the optimal transport is T itself, so that the distance is
|mean (I - T)|² + |Xc (I - T)|²_F / (n - 1): exact for singular covariances too.
"""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.metrics.features.frechet import frechet_distance
from mirror.metrics.features.statistics import FeatureAccumulator, FeatureStatistics
from tests.draws import draws


def spectrum(n, d, seed=0, power=0.8):
    """Non-negative features with a power-law spectrum, as pooled networks give."""
    draw = np.random.default_rng(seed)
    turn = np.linalg.qr(draw.standard_normal((d, d)))[0]
    scales = np.arange(1, d + 1) ** -power
    return np.maximum(draw.standard_normal((n, d)) @ (scales[:, None] * turn) + 0.4, 0.0)


def transported(x, seed=1):
    d = x.shape[1]
    draw = np.random.default_rng(seed)
    turn = np.linalg.qr(draw.standard_normal((d, d)))[0]
    transport = (turn * draw.uniform(0.6, 1.4, d)) @ turn.T
    transport = (transport + transport.T) / 2.0
    kind = np.longdouble if x.size < 1e5 else np.float64
    wide = x.astype(kind)
    rest = np.eye(d) - transport.astype(kind)
    centred = wide - wide.mean(axis=0)
    truth = float(((wide.mean(axis=0) @ rest) ** 2).sum() + ((centred @ rest) ** 2).sum() / (len(x) - 1))
    return x @ transport, truth


@pytest.mark.parametrize("n", [2, 3, 50, 96, 97, 600])
def test_transport(n):
    x = spectrum(n, 96)
    y, truth = transported(x)
    got = frechet_distance(x, y)
    assert abs(got.value - truth) <= 1e-11 * truth
    assert abs(got.value - truth) <= got.error
    assert got.rank == min(n - 1, 96)
    assert got.n == (n, n)


@pytest.mark.parametrize(
    ("n", "method"), [(300, "singular values"), (301, "gram eigenvalues"), (1200, "gram eigenvalues")]
)
def test_transport_where_matrices_are_large(n, method):
    x = spectrum(n if n != 301 else 2500, 300)
    y, truth = transported(x)
    got = frechet_distance(x, y)
    assert got.method == method
    assert abs(got.value - truth) <= min(5e-11 * truth, got.error)


def test_one_few_one_many():
    d = 40
    x, y = spectrum(12, d), spectrum(500, d, seed=5)
    one, other = frechet_distance(x, y), frechet_distance(y, x)
    c1, c2 = np.cov(x.T), np.cov(y.T)
    values, vectors = np.linalg.eigh(c2)
    root = (vectors * np.sqrt(values)) @ vectors.T
    inner = np.sqrt(np.maximum(np.linalg.eigvalsh(root @ c1 @ root), 0.0)).sum()
    truth = ((x.mean(axis=0) - y.mean(axis=0)) ** 2).sum() + np.trace(c1) + np.trace(c2) - 2 * inner
    assert one.value == pytest.approx(truth, abs=1e-6)
    assert abs(one.value - other.value) <= one.error


@pytest.mark.parametrize("n", [1000, 2000])
def test_ill_conditioned_covariances_fall_back_to_singular_values(n):
    draw = np.random.default_rng(3)
    x = draw.standard_normal((n, 300)) * np.geomspace(1.0, 1e-7, 300)
    y = x * np.linspace(0.5, 1.5, 300)
    centred = x - x.mean(axis=0)
    rest = 1.0 - np.linspace(0.5, 1.5, 300)
    truth = float(((x.mean(axis=0) * rest) ** 2).sum() + ((centred * rest) ** 2).sum() / (n - 1))
    got = frechet_distance(x, y)
    assert got.method == "singular values"
    assert abs(got.value - truth) <= 1e-11 * truth


def test_one_dimension_is_exact():
    x, y = np.array([[0.0], [2.0], [4.0]]), np.array([[1.0], [2.0]])
    apart = Fraction(2) - Fraction(3, 2)
    truth = float(apart**2) + (2.0 - np.sqrt(0.5)) ** 2
    assert frechet_distance(x, y).value == pytest.approx(truth, rel=1e-15)


def test_diagonal_moments():
    a, b = np.array([4.0, 9.0, 0.0]), np.array([1.0, 16.0, 25.0])
    mean = np.array([1.0, 2.0, 3.0])
    one = FeatureStatistics.from_moments(mean, np.diag(a), 100)
    other = FeatureStatistics.from_moments(mean * 2, np.diag(b), 100)
    truth = float((mean**2).sum() + ((np.sqrt(a) - np.sqrt(b)) ** 2).sum())
    assert frechet_distance(one, other).value == pytest.approx(truth, rel=1e-14)


def test_singular_statistics_take_the_pivoted_factor():
    x = spectrum(30, 60)
    y, truth = transported(x)
    one, other = (FeatureStatistics.from_moments(v.mean(axis=0), np.cov(v.T), 30) for v in (x, y))
    got = frechet_distance(one, other)
    assert abs(got.value - truth) <= 1e-9
    assert got.rank == 29


@pytest.mark.parametrize("n", [1, 2, 30, 400])
def test_identical_sets_are_exactly_zero(n):
    x = spectrum(n, 64)
    assert frechet_distance(x, x.copy(), ddof=0).value == 0.0
    assert frechet_distance(x, x.copy(), ddof=0).error == 0.0
    shuffled = frechet_distance(x, x[::-1].copy(), ddof=0)
    assert 0.0 <= shuffled.value <= shuffled.error


@settings(max_examples=draws(25), deadline=None)
@given(n=st.integers(2, 40), m=st.integers(2, 40), d=st.integers(1, 30), seed=st.integers(0, 999))
def test_symmetric_and_unmoved_by_rotation_and_offset(n, m, d, seed):
    draw = np.random.default_rng(seed)
    x, y = draw.standard_normal((n, d)), draw.standard_normal((m, d)) * 2.0 + 1.0
    got = frechet_distance(x, y)
    assert got.value >= 0.0
    turn = np.linalg.qr(draw.standard_normal((d, d)))[0]
    for moved in (frechet_distance(y, x), frechet_distance(x @ turn, y @ turn), frechet_distance(x + 8.0, y + 8.0)):
        assert moved.value == pytest.approx(got.value, rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("scale", [1e-150, 1e-8, 1e8, 1e150])
def test_scale_comes_out_squared(scale):
    x, y = spectrum(20, 32), spectrum(25, 32, seed=9)
    assert frechet_distance(x * scale, y * scale).value == pytest.approx(
        frechet_distance(x, y).value * scale * scale, rel=1e-12
    )


@pytest.mark.parametrize("offset", [1e4, 1e6, 1e8])
def test_a_shift_at_an_offset(offset):
    x = np.random.default_rng(0).integers(0, 16, (30, 50)).astype(np.float64) + offset
    got = frechet_distance(x, x + 0.25)
    assert abs(got.value - 50 * 0.0625) <= got.error <= 1e-5


def test_the_bound_holds_what_rounding_did_to_the_means():
    """Two means far out and close together: a rounding of one of their entries moves the distance within the bound."""
    covariance = np.eye(2)
    first, second = np.full(2, 1e8), np.full(2, 1e8 + 1)
    rounded = np.nextafter(second, np.inf)
    found, moved = (
        frechet_distance(
            FeatureStatistics.from_moments(first, covariance, 9), FeatureStatistics.from_moments(mean, covariance, 9)
        )
        for mean in (second, rounded)
    )
    assert found.value == pytest.approx(2.0, abs=1e-6)
    assert 1e-8 < abs(moved.value - found.value) < found.error < 1e-6


def test_the_bound_is_as_large_from_either_side():
    rng = np.random.default_rng(0)
    first = rng.normal(size=(400, 12)) * np.geomspace(1, 1e-5, 12)
    second = rng.normal(size=(90, 12)) + 0.1
    one, other = frechet_distance(first, second), frechet_distance(second, first)
    assert one.value == pytest.approx(other.value, abs=one.error)
    assert one.error == pytest.approx(other.error, rel=1e-6)


def test_flat_features():
    got = frechet_distance(np.full((9, 5), 0.1), np.full((7, 5), 0.4))
    assert got.value == pytest.approx(5 * 0.09, rel=1e-13)
    assert got.rank == 0


def test_ddof():
    x, y = spectrum(50, 8), spectrum(50, 8, seed=2)
    one, zero = frechet_distance(x, y), frechet_distance(x, y, ddof=0)
    apart = ((x.mean(axis=0) - y.mean(axis=0)) ** 2).sum()
    assert zero.value - apart == pytest.approx((one.value - apart) * 49 / 50, rel=1e-12)


def test_streams_and_arrays_agree():
    x, y = spectrum(300, 20), spectrum(200, 20, seed=4)
    streams = []
    for values in (x, y):
        stream = FeatureAccumulator()
        for part in np.array_split(values, 9):
            stream.update(part)
        streams.append(stream.compute())
    assert frechet_distance(*streams).value == pytest.approx(frechet_distance(x, y).value, rel=1e-12)


def test_errors():
    x = spectrum(5, 4)
    with pytest.raises(UsageError, match="dimensions"):
        frechet_distance(x, spectrum(5, 6))
    with pytest.raises(UsageError, match="no covariance"):
        frechet_distance(x, x[:1])
    with pytest.raises(UsageError, match="NaN"):
        frechet_distance(x, np.where(x == x.max(), np.nan, x))
    crooked = FeatureStatistics.from_moments(np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]]), 9)
    with pytest.raises(UsageError, match="not positive semidefinite"):
        frechet_distance(crooked, FeatureStatistics.from_moments(np.zeros(2), np.eye(2), 9))


@pytest.mark.parametrize(("power", "method"), [(0.8, "gram eigenvalues"), (2.0, "singular values")])
def test_the_gram_is_only_used_where_its_error_is_small(power, method):
    x = spectrum(1200, 300, power=power)
    y, truth = transported(x)
    got = frechet_distance(x, y)
    assert got.method == method
    assert abs(got.value - truth) <= 1e-11 * truth
