"""Fréchet distance of two normal distributions, from features or their statistics, with a bound of its rounding error.

    d = |m1 - m2|² + tr C1 + tr C2 - 2 tr (C1 C2)^½    (Dowson and Landau, 1982)

The last trace is the nuclear norm of R1 R2ᵀ for any roots RᵢᵀRᵢ = Cᵢ: its singular values, never the square roots of
eigenvalues of C1 C2, which turn rounding of 1e-16 into 1e-8 in every direction that has no variance. With fewer
features than dimensions the centred features themselves are such roots, and the matrix is as small as their number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirror.arrays import AnyArray, Float64
from mirror.errors import UsageError
from mirror.metrics.features.roots import UNIT_ROUNDOFF, CovarianceRoot, covariance_root
from mirror.metrics.features.statistics import FeatureStatistics

_SMALL = 256
GRAM_TOLERANCE = 2e-11


@dataclass(frozen=True)
class FrechetDistance:
    """A Fréchet distance.

    Attributes:
        value: squared distance, as FID and FVD report it; never negative.
        error: bound of its rounding error, of the probabilistic kind (rounding errors independent): not of its
            sampling error, which for few features is far larger.
        rank: number of directions in which both sets vary together.
        n: number of features of both sets.
        ddof: what was taken off n in the covariances.
        method: ``identical | singular values | gram eigenvalues``.
    """

    value: float
    error: float
    rank: int
    n: tuple[int, int]
    ddof: int
    method: str


def frechet_distance(
    a: AnyArray | FeatureStatistics, b: AnyArray | FeatureStatistics, *, ddof: int = 1
) -> FrechetDistance:
    """Return the squared Fréchet distance of two sets of features.

    Args:
        a: (n, d) features, or their statistics.
        b: (m, d) features, or their statistics.
        ddof: 1, or 0 for covariances over n.

    Raises:
        UsageError: dimensions differ, values are not finite, n <= ddof, or a covariance is not one.
    """
    first = a if isinstance(a, FeatureStatistics) else FeatureStatistics.from_features(a)
    second = b if isinstance(b, FeatureStatistics) else FeatureStatistics.from_features(b)
    if first.dimension != second.dimension:
        raise UsageError(f"features of {first.dimension} and of {second.dimension} dimensions")
    n = (first.count, second.count)
    if _identical(first, second):
        rank = min(first.degrees(ddof), first.dimension)
        return FrechetDistance(0.0, 0.0, rank, n, ddof, "identical")
    root_a, root_b = covariance_root(first, ddof), covariance_root(second, ddof)
    trace = root_a.trace + root_b.trace
    overlap = _overlap(root_a, root_b)
    step = first.mean - second.mean
    apart = float(step @ step)
    value = apart + trace - 2.0 * overlap.norm
    offset = 2.0 * UNIT_ROUNDOFF * (float(np.linalg.norm(first.mean)) + float(np.linalg.norm(second.mean)))
    length = float(np.sqrt(first.dimension)) * UNIT_ROUNDOFF
    error = 2.0 * overlap.error + offset * (2.0 * float(np.sqrt(apart)) + offset) + length * (apart + trace)
    error += root_a.inexact + root_b.inexact + _moved(root_a, root_b) + _moved(root_b, root_a)
    if value < -error:
        raise UsageError(
            f"the Fréchet distance came out as {value:.3g}, below its error bound {error:.3g}",
            expected="statistics of one kind on both sides",
            remedy="compute the statistics again from the features",
        )
    return FrechetDistance(max(value, 0.0), error, overlap.rank, n, ddof, overlap.method)


@dataclass(frozen=True)
class _Overlap:
    norm: float
    error: float
    rank: int
    method: str


def _overlap(a: CovarianceRoot, b: CovarianceRoot) -> _Overlap:
    """Nuclear norm of the cross product of two roots.

    For two scatter matrices, the eigenvalues of the Gram matrix are computed first: they take a quarter of the time,
    and they bound the rounding error of their square roots. If this bound is too large, the singular values are used.
    """
    size = min(len(a.root), len(b.root))
    # Rounding of the product itself, entry by entry, as a nuclear norm.
    product = UNIT_ROUNDOFF * float(np.sqrt(a.root.shape[1] * size) * np.sqrt(a.trace * b.trace))
    if size > _SMALL and a.covariance is not None and b.covariance is not None:
        from scipy.linalg.lapack import dsygst

        # The lower triangle of R1 C2 R1', of which only half is computed.
        gram, _ = dsygst(b.covariance, a.root.T, itype=2, lower=1)
        values = np.linalg.eigvalsh(gram)
        top = float(values[-1])
        sigma = np.sqrt(np.maximum(values, 0.0))
        moved = 4.0 * UNIT_ROUNDOFF * top
        with np.errstate(divide="ignore"):
            error = float(np.linalg.norm(np.minimum(np.sqrt(moved), moved / (2.0 * sigma))))
        if error <= GRAM_TOLERANCE * (a.trace + b.trace):
            return _Overlap(float(sigma.sum()), product + error, size, "gram eigenvalues")
    cross = a.root @ b.root.T
    sigma = np.linalg.svd(cross, compute_uv=False)
    top = float(sigma[0]) if size else 0.0
    rank = int((sigma > size * UNIT_ROUNDOFF * 2.0 * top).sum())
    return _Overlap(float(sigma.sum()), product + size * UNIT_ROUNDOFF * top, rank, "singular values")


def _moved(a: CovarianceRoot, b: CovarianceRoot) -> float:
    """Estimate how far rounding in one covariance moves twice the overlap.

    To first order by |C1^-½ C2^½|, or where C1 is singular by the inequality of Powers and Størmer (1970),
    |C1^½ - C1'^½|_F² <= |C1 - C1'|_*; the smaller of both bounds.
    """
    if a.inexact == 0.0:
        return 0.0
    always = 2.0 * float(np.sqrt(a.inexact * b.trace))
    return min(always, a.inexact * float(np.sqrt(b.largest / a.least))) if a.least > 0.0 else always


def _identical(a: FeatureStatistics, b: FeatureStatistics) -> bool:
    """Return whether both are the same numbers: their distance is exactly 0."""
    if a is b:
        return True
    if a.count != b.count or not np.array_equal(a.mean, b.mean):
        return False
    return _same(a.rows, b.rows) and _same(a.scatter, b.scatter)


def _same(a: Float64 | None, b: Float64 | None) -> bool:
    if a is None or b is None:
        return a is b
    return bool(np.array_equal(a, b))
