"""Elementary functions and products of arrays, with the same bits on every x86-64 processor (see `scalars`).

The functions have numpy's names and rules of broadcasting; their results are float64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numba import vectorize
from numpy.typing import ArrayLike

from mirror.arrays import Float64
from mirror.synth.portable import scalars

_ufunc: Final[Callable[[Any], Any]] = vectorize(cache=True)


@_ufunc
def sin(x: float) -> float:
    """The sine; see `scalars.sin`."""
    return scalars.sin(x)


@_ufunc
def cos(x: float) -> float:
    """The cosine; see `scalars.cos`."""
    return scalars.cos(x)


@_ufunc
def tan(x: float) -> float:
    """The tangent; see `scalars.tan`."""
    return scalars.tan(x)


@_ufunc
def arcsin(x: float) -> float:
    """The arc sine; see `scalars.asin`."""
    return scalars.asin(x)


@_ufunc
def arccos(x: float) -> float:
    """The arc cosine; see `scalars.acos`."""
    return scalars.acos(x)


@_ufunc
def exp(x: float) -> float:
    """The exponential function; see `scalars.exp`."""
    return scalars.exp(x)


@_ufunc
def log(x: float) -> float:
    """The natural logarithm; see `scalars.log`."""
    return scalars.log(x)


@_ufunc
def arctan2(y: float, x: float) -> float:
    """The angle of a point (x, y); see `scalars.atan2`."""
    return scalars.atan2(y, x)


@_ufunc
def power(x: float, y: float) -> float:
    """A power of numbers of at least 0; see `scalars.power`."""
    return scalars.power(x, y)


@_ufunc
def hypot(x: float, y: float) -> float:
    """The length of vectors (x, y); see `scalars.hypot`."""
    return scalars.hypot(x, y)


def norm(vector: ArrayLike) -> float:
    """The length of one vector (N,)."""
    given = np.asarray(vector, np.float64).ravel()
    return float(np.sqrt(np.add.reduce(given * given)))


def matmul(a: ArrayLike, b: ArrayLike) -> Any:
    """The matrix product of two arrays of one or more axes, with the shapes of `numpy.matmul`."""
    left, right = np.asarray(a), np.asarray(b)
    inner = "i" if left.ndim == 1 else "...ij"
    if left.ndim == 1:
        subscripts = "i,i->" if right.ndim == 1 else "i,...ij->...j"
    else:
        subscripts = f"{inner},j->...i" if right.ndim == 1 else f"{inner},...jk->...ik"
    return np.einsum(subscripts, left, right)


def convolve(values: ArrayLike, window: ArrayLike) -> Float64:
    """The values (N,) weighted by a window (M,) at each place where it fits: (N - M + 1,)."""
    given, weights = np.asarray(values, np.float64), np.asarray(window, np.float64)
    count = len(given) - len(weights) + 1
    total = np.zeros(count)
    for i, weight in enumerate(weights[::-1]):
        total += weight * given[i : i + count]
    return total


def solve(matrix: ArrayLike, known: ArrayLike) -> Float64:
    """Solve systems of N equations by Gaussian elimination with the largest pivots of columns.

    Args:
        matrix: (..., N, N) coefficients, not singular.
        known: (..., N) or (..., N, K) right sides; as many axes as `matrix` for the second form.

    Returns:
        The unknowns, of the shape of `known`.

    Raises:
        numpy.linalg.LinAlgError: a matrix is singular.
    """
    a, b = np.array(matrix, np.float64), np.array(known, np.float64)
    is_vector = b.ndim < a.ndim
    if is_vector:
        b = b[..., None]
    shape = np.broadcast_shapes(a.shape[:-2], b.shape[:-2])
    size = a.shape[-1]
    rows = np.concatenate(
        [np.broadcast_to(a, (*shape, size, size)), np.broadcast_to(b, (*shape, size, b.shape[-1]))], axis=-1
    ).reshape(-1, size, size + b.shape[-1])
    every = np.arange(len(rows))
    for column in range(size):
        pivot = column + np.abs(rows[:, column:, column]).argmax(axis=1)
        rows[every, column], rows[every, pivot] = rows[every, pivot].copy(), rows[every, column].copy()
        if (rows[:, column, column] == 0.0).any():
            raise np.linalg.LinAlgError("singular matrix")
        rows[:, column] /= rows[:, column, column, None]
        for other in range(size):
            if other != column:
                rows[:, other] -= rows[:, other, column, None] * rows[:, column]
    found = rows[:, :, size:].reshape(*shape, size, b.shape[-1])
    return np.ascontiguousarray(found[..., 0] if is_vector else found)
