"""Square roots of covariances: R with RᵀR = covariance, without squaring what is not already squared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.metrics.features.statistics import FeatureStatistics

UNIT_ROUNDOFF = float(np.finfo(np.float64).eps / 2)


@dataclass(frozen=True, eq=False)
class CovarianceRoot:
    """A matrix R whose product RᵀR is a covariance.

    Attributes:
        root: (k, d).
        covariance: (d, d), where the root is its upper triangular factor; None: the root is of another kind.
        trace: of the covariance.
        inexact: nuclear norm of what rounding may have changed in the covariance before R was taken; 0 for rows.
        least: estimate of the least eigenvalue; 0 where the covariance is singular.
        largest: bound of the largest eigenvalue.
    """

    root: Float64
    covariance: Float64 | None
    trace: float
    inexact: float
    least: float
    largest: float


def covariance_root(statistics: FeatureStatistics, ddof: int) -> CovarianceRoot:
    """Return the root of the covariance of features.

    Centred rows over sqrt(n - ddof) are a root as they are. Of a scatter matrix it is the Cholesky factor, and the
    pivoted one (LAPACK ``dpstrf``) where the covariance is singular.

    Raises:
        UsageError: too few features, or a covariance with negative eigenvalues.
    """
    degrees = statistics.degrees(ddof)
    if statistics.rows is not None:
        root: Float64 = statistics.rows / float(np.sqrt(degrees))
        trace = float(np.einsum("ij,ij->i", root, root).sum())
        return CovarianceRoot(root, None, trace, 0.0, 0.0, trace)
    covariance = statistics.covariance(ddof)
    trace = float(np.trace(covariance))
    dimension = statistics.dimension
    inexact = UNIT_ROUNDOFF * trace * float(np.sqrt(dimension) * (np.sqrt(statistics.count) + np.sqrt(dimension)))
    from scipy.linalg.lapack import dpocon, dpotrf

    one_norm = float(np.abs(covariance).sum(axis=0).max())
    largest = min(trace, one_norm)
    # A symmetric matrix is its own transpose, one of which has the order of columns that LAPACK takes uncopied.
    lower, info = dpotrf(
        np.asfortranarray(covariance if covariance.flags.f_contiguous else covariance.T), lower=1, clean=0
    )
    if info != 0:
        return CovarianceRoot(_pivoted_root(covariance, trace), None, trace, inexact, 0.0, largest)
    for column in range(1, dimension):
        lower[:column, column] = 0.0
    reciprocal, info = dpocon(lower, one_norm, uplo="L")
    least = one_norm * float(reciprocal) if info == 0 else 0.0
    return CovarianceRoot(lower.T, covariance, trace, inexact, least, largest)


def _pivoted_root(covariance: Float64, trace: float) -> Float64:
    """(rank, d) root of a singular covariance, by Cholesky with complete pivoting (Higham, 2002, section 10.3)."""
    from scipy.linalg.lapack import dpstrf

    dimension = covariance.shape[0]
    tolerance = dimension * UNIT_ROUNDOFF * float(np.diag(covariance).max())
    factor, pivots, rank, _ = dpstrf(covariance, tol=tolerance, lower=1)
    lower = np.tril(factor)[:, :rank]
    root = np.empty((rank, dimension))
    root[:, pivots - 1] = lower.T
    off = float(np.abs(root.T @ root - covariance).max())
    if off > 1e3 * max(tolerance, dimension * UNIT_ROUNDOFF * trace):
        raise UsageError(
            f"a covariance is not positive semidefinite: its pivoted Cholesky factor is off by {off:.3g}",
            expected="mean and covariance of features",
            remedy="compute the statistics again from the features; an indefinite matrix often comes from "
            "E[xx'] - mean mean' at a large offset, or from float32",
        )
    return root
