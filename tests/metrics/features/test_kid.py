import itertools
from fractions import Fraction

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.metrics.features.kid import LARGEST_WHOLE, kid


def exact(x, y):
    """Unbiased estimate in rational numbers."""
    d = len(x[0])

    def kernel(p, q):
        return (sum(Fraction(a) * Fraction(b) for a, b in zip(p, q)) / d + 1) ** 3

    def within(rows):
        pairs = list(itertools.permutations(rows, 2))
        return sum(kernel(p, q) for p, q in pairs) / len(pairs)

    return float(within(x) + within(y) - 2 * sum(kernel(p, q) for p in x for q in y) / (len(x) * len(y)))


def test_whole_sets_are_exact():
    draw = np.random.default_rng(0)
    x, y = draw.integers(-3, 4, (7, 4)).tolist(), draw.integers(-3, 4, (7, 4)).tolist()
    got = kid(np.array(x), np.array(y), subset_size=7, subsets=3)
    assert got.value == pytest.approx(exact(x, y), rel=1e-13)
    assert got.deviation == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(got.interval).all()


def test_unbiased():
    """Over many draws of one distribution the mean is 0 within its own error; a biased estimate would be far off."""
    draw = np.random.default_rng(1)
    values = [kid(draw.standard_normal((20, 8)), draw.standard_normal((20, 8)), subsets=4).value for _ in range(300)]
    assert abs(np.mean(values)) < 4.0 * np.std(values) / np.sqrt(len(values))


def test_the_interval_covers_the_truth():
    """Truth from very many samples; 95 % intervals hold it about that often."""
    draw = np.random.default_rng(2)
    truth = kid(
        draw.standard_normal((3000, 4)), draw.standard_normal((3000, 4)) + 0.8, subset_size=1500, subsets=5
    ).value
    held = 0
    for seed in range(40):
        low, high = kid(
            draw.standard_normal((150, 4)), draw.standard_normal((150, 4)) + 0.8, subsets=50, seed=seed
        ).interval
        held += low <= truth <= high
    assert held >= 33


def test_seed():
    draw = np.random.default_rng(3)
    x, y = draw.standard_normal((60, 16)), draw.standard_normal((80, 16)) + 0.2
    one = kid(x, y, seed=5)
    assert one == kid(x, y, seed=5)
    assert one.value != kid(x, y, seed=6).value
    assert one.subset_size == 30
    assert one.n == (60, 80)


@pytest.mark.parametrize("count", [LARGEST_WHOLE, LARGEST_WHOLE + 1])
def test_a_set_too_large_for_one_matrix_has_the_distance_of_the_definition(count):
    """Whichever of the equal features a subset draws: it is the same subset, and all of the others."""
    draw = np.random.default_rng(3)
    x, y = draw.standard_normal(16), draw.standard_normal((80, 16)) + 0.2
    within = sum((y[i] @ y[j] / 16 + 1) ** 3 for i in range(80) for j in range(80) if i != j) / (80 * 79)
    expected = (x @ x / 16 + 1) ** 3 + within - 2 * np.mean((y @ x / 16 + 1) ** 3)
    found = kid(np.tile(x, (count, 1)), y, subsets=3, subset_size=80, seed=5)
    assert found.value == pytest.approx(expected, rel=1e-12)
    assert found.deviation == pytest.approx(0.0, abs=1e-12)


def test_errors():
    x = np.ones((5, 3))
    for call in (
        lambda: kid(x, np.ones((5, 4))),
        lambda: kid(x, x, subset_size=6),
        lambda: kid(x, x[:1]),
        lambda: kid(x, x * np.nan),
        lambda: kid(x, x, subsets=0),
        lambda: kid(x, x, level=1.0),
    ):
        with pytest.raises(UsageError):
            call()


def test_few_against_many_needs_little_memory():
    """The kernel of all 100,000 features among themselves would take 80 GB."""
    draw = np.random.default_rng(2)
    got = kid(draw.standard_normal((10, 2)), draw.standard_normal((100_000, 2)), subset_size=5, subsets=3)
    assert np.isfinite(got.value)
