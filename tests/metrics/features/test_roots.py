"""Square roots of covariances, and what is known of their eigenvalues."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.metrics.features.roots import covariance_root
from mirror.metrics.features.statistics import FeatureStatistics


def made(count: int, spread: np.ndarray) -> FeatureStatistics:
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(len(spread), len(spread))))[0]
    return FeatureStatistics.from_features(rng.normal(size=(count, len(spread))) * spread @ turn)


@pytest.mark.parametrize("ddof", [0, 1])
@pytest.mark.parametrize("count", [5, 300])
def test_the_root_squared_is_the_covariance(count: int, ddof: int) -> None:
    statistics = made(count, np.geomspace(1.0, 1e-3, 8))
    found = covariance_root(statistics, ddof)
    covariance = statistics.covariance(ddof)
    np.testing.assert_allclose(found.root.T @ found.root, covariance, atol=1e-14)
    assert found.trace == pytest.approx(np.trace(covariance), rel=1e-13)
    assert found.largest >= np.linalg.eigvalsh(covariance)[-1] * (1 - 1e-12)
    # Rows are a root as they are; a scatter has been rounded.
    assert (found.inexact > 0.0) == (count > 8)


def test_the_least_eigenvalue_is_estimated() -> None:
    """LAPACK's estimate of the condition number (Hager and Higham) is rarely off by more than a factor of 3, and 8
    dimensions between norms are another."""
    statistics = made(300, np.geomspace(1.0, 1e-3, 8))
    least = np.linalg.eigvalsh(statistics.covariance(1))[0]
    assert least / 10 < covariance_root(statistics, 1).least < 3 * least


def test_a_singular_covariance_has_a_root_and_no_least_eigenvalue() -> None:
    spread = np.array([1.0, 1.0, 0.5, 0.0, 0.0])
    rng = np.random.default_rng(0)
    covariance = np.diag(spread**2)
    found = covariance_root(FeatureStatistics.from_moments(np.zeros(5), covariance, 100), 1)
    np.testing.assert_allclose(found.root.T @ found.root, covariance, atol=1e-14)
    assert (found.root.shape, found.least) == ((3, 5), 0.0)
    turn = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    indefinite = turn * np.array([1.0, 1.0, 1.0, 1.0, -0.5]) @ turn.T
    with pytest.raises(UsageError, match="not positive semidefinite"):
        covariance_root(FeatureStatistics.from_moments(np.zeros(5), (indefinite + indefinite.T) / 2, 100), 1)
