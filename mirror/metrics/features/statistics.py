"""Mean and scatter of features, exact under any offset, any order of batches and fewer samples than dimensions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mirror.arrays import AnyArray, Float64
from mirror.errors import UsageError
from mirror.metrics.inputs import as_numbers

_BLOCK = 1024
_PENDING = 2048
_TILE = 128


@dataclass(frozen=True, eq=False)
class FeatureStatistics:
    """The mean and the scatter of a set of features, which a Fréchet distance needs.

    No more rows than dimensions: the centred rows themselves are kept, because the scatter would square their
    condition and cost more memory. More rows: their scatter, the sum of outer products about the mean.

    Attributes:
        count: number of features, n.
        mean: (d,).
        rows: (n, d) centred features, or None.
        scatter: (d, d), or None; exactly one of both is there.
    """

    count: int
    mean: Float64
    rows: Float64 | None = None
    scatter: Float64 | None = None

    def __post_init__(self) -> None:
        if (self.rows is None) == (self.scatter is None):
            raise UsageError("statistics of features hold either centred rows or a scatter matrix, never both or none")

    @property
    def dimension(self) -> int:
        """Number of dimensions, d."""
        return int(self.mean.shape[0])

    @classmethod
    def from_features(cls, features: AnyArray) -> FeatureStatistics:
        """Return the statistics of features that fit in memory.

        The mean is taken twice: the second pass takes away what rounding left of a large offset in the first. Blocks
        of rows are centred as they are needed, so that no second copy of all features exists.

        Args:
            features: (n, d), finite, any real type; converted to float64.

        Raises:
            UsageError: not (n, d) with n, d >= 1, or not finite.
        """
        values = checked_features(features)
        count, dimension = values.shape
        if count <= dimension:
            mean = values[0] + (values - values[0]).mean(axis=0)
            rows = values - mean
            rest = rows.mean(axis=0)
            rows -= rest
            return cls(count, mean + rest, rows=rows)
        from scipy.linalg.blas import dsyr, dsyrk

        block = np.empty((_BLOCK, dimension))

        def centred(about: Float64) -> Iterator[Float64]:
            for start in range(0, count, _BLOCK):
                batch = values[start : start + _BLOCK]
                yield np.subtract(batch, about, out=block[: len(batch)])

        mean = np.full(count, 1.0 / count) @ values
        scatter, total = np.zeros((dimension, dimension), order="F"), np.zeros(dimension)
        for part in centred(mean):
            total += part.sum(axis=0)
            scatter = dsyrk(1.0, part.T, beta=1.0, c=scatter, lower=1, overwrite_c=1)
        # What rounding left of the mean, off the lower triangle alone; then the other half is copied.
        scatter = dsyr(-1.0 / count, total, lower=1, a=scatter, overwrite_a=1)
        for start in range(0, dimension, _TILE):
            end = start + _TILE
            scatter[start:end, end:] = scatter[end:, start:end].T
            square = scatter[start:end, start:end]
            square += np.tril(square, -1).T - np.triu(square, 1)
        return cls(count, mean + total / count, scatter=scatter)

    @classmethod
    def from_moments(cls, mean: AnyArray, covariance: AnyArray, count: int) -> FeatureStatistics:
        """Return the statistics from a mean and a covariance (``ddof`` 1), as other tools store them.

        Args:
            mean: (d,).
            covariance: (d, d), symmetric.
            count: number of features behind them.

        Raises:
            UsageError: shapes do not fit, a value is not finite, or the covariance is not symmetric.
        """
        mean = as_numbers(mean, "mean", np.float64)
        covariance = as_numbers(covariance, "covariance", np.float64)
        if mean.ndim != 1 or covariance.shape != (mean.size, mean.size):
            raise UsageError(
                f"a mean of shape {mean.shape} and a covariance of shape {covariance.shape}", expected="(d,) and (d, d)"
            )
        if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
            raise UsageError("a mean or a covariance has NaN or infinite values")
        if np.abs(covariance - covariance.T).max() > 1e-6 * np.abs(covariance).max():
            raise UsageError("a covariance is not symmetric")
        if count < 2:
            raise UsageError(f"a covariance of {count} features", expected="at least 2")
        return cls(count, mean, scatter=(covariance + covariance.T) * (0.5 * (count - 1)))

    def merge(self, other: FeatureStatistics) -> FeatureStatistics:
        """Return the statistics of both sets together.

        After Chan, Golub and LeVeque, "Updating formulae and a pairwise algorithm for computing sample variances"
        (1979): only differences of means enter, so that an offset costs no digits.

        Raises:
            UsageError: the dimensions differ.
        """
        if other.dimension != self.dimension:
            raise UsageError(f"features of {other.dimension} dimensions cannot be merged with {self.dimension}")
        count = self.count + other.count
        step = other.mean - self.mean
        mean = self.mean + step * (other.count / count)
        if self.rows is not None and other.rows is not None and count <= self.dimension:
            back = step * (other.count / count)
            rows = np.concatenate([self.rows - back, other.rows + (step - back)])
            return FeatureStatistics(count, mean, rows=rows)
        scatter = self._scatter() + other._scatter()
        scatter += np.outer(step, step) * (self.count * other.count / count)
        return FeatureStatistics(count, mean, scatter=scatter)

    def covariance(self, ddof: int = 1) -> Float64:
        """Return the covariance (d, d), divided by n - ``ddof``.

        Raises:
            UsageError: n <= ddof.
        """
        return self._scatter() / self.degrees(ddof)

    def degrees(self, ddof: int) -> int:
        """Return the number of degrees of freedom, n - ``ddof``.

        Raises:
            UsageError: n <= ddof, or ``ddof`` is neither 0 nor 1.
        """
        if ddof not in (0, 1):
            raise UsageError(f"ddof is {ddof}", expected="0 or 1")
        if self.count <= ddof:
            raise UsageError(
                f"{self.count} feature has no covariance with ddof={ddof}", remedy="score more images, at least 2"
            )
        return self.count - ddof

    def _scatter(self) -> Float64:
        if self.rows is None:
            return self.scatter  # type: ignore[return-value]
        scatter: Float64 = self.rows.T @ self.rows
        return scatter


class FeatureAccumulator:
    """An accumulator of statistics of features in batches of any size, which holds at most about d + 2048 rows."""

    def __init__(self) -> None:
        self._done: FeatureStatistics | None = None
        self.pending: list[Float64] = []

    def update(self, features: AnyArray) -> None:
        """Add a batch.

        Args:
            features: (n, d).

        Raises:
            UsageError: not finite, or of another dimension than those before.
        """
        batch = checked_features(features)
        dimension = self._dimension()
        if dimension not in (None, batch.shape[1]):
            raise UsageError(f"a batch of {batch.shape[1]} dimensions after batches of {dimension}")
        self.pending.append(batch.copy() if batch is features else batch)
        if sum(map(len, self.pending)) > max(batch.shape[1], _PENDING):
            self._done, self.pending = self.compute(), []

    def merge(self, other: FeatureAccumulator) -> None:
        """Add all that another accumulator has seen."""
        if other._done is not None:
            self._done = other._done if self._done is None else self._done.merge(other._done)
        for batch in other.pending:
            self.update(batch)

    def compute(self) -> FeatureStatistics:
        """Return the statistics of all batches so far.

        Raises:
            UsageError: there were none.
        """
        if not self.pending:
            if self._done is None:
                raise UsageError("no features were added")
            return self._done
        recent = FeatureStatistics.from_features(np.concatenate(self.pending))
        return recent if self._done is None else self._done.merge(recent)

    def _dimension(self) -> int | None:
        if self._done is not None:
            return self._done.dimension
        return self.pending[0].shape[1] if self.pending else None


def checked_features(features: AnyArray) -> Float64:
    """Return the features as float64 (n, d).

    Raises:
        UsageError: another shape, empty, or a value that is not finite.
    """
    values = as_numbers(features, "features")
    if values.ndim != 2 or 0 in values.shape or values.dtype.kind not in "fiu":
        raise UsageError(f"features of shape {values.shape} and type {values.dtype}", expected="(n, d) real, n, d >= 1")
    values = values.astype(np.float64, copy=False)
    finite = np.isfinite(values).all(axis=1)
    if not finite.all():
        bad = np.flatnonzero(~finite)
        raise UsageError(
            f"{bad.size} of {finite.size} features have NaN or infinite values",
            place=f"row {bad[0]}",
            expected="finite",
        )
    return values
