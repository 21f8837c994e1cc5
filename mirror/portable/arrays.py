"""Elementary functions and products of arrays, with the same bits on every x86-64 processor (see `scalars`).

The functions have numpy's names and rules of broadcasting; their results are float64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mirror.arrays import Float64
from mirror.compiled import per_pixel
from mirror.portable import scalars


def sin(x: ArrayLike) -> Any:
    """Return the sine; see `scalars.sin`."""
    return _fill(_sin, x)


def cos(x: ArrayLike) -> Any:
    """Return the cosine; see `scalars.cos`."""
    return _fill(_cos, x)


def tan(x: ArrayLike) -> Any:
    """Return the tangent; see `scalars.tan`."""
    return _fill(_tan, x)


def arcsin(x: ArrayLike) -> Any:
    """Return the arc sine; see `scalars.asin`."""
    return _fill(_arcsin, x)


def arccos(x: ArrayLike) -> Any:
    """Return the arc cosine; see `scalars.acos`."""
    return _fill(_arccos, x)


def exp(x: ArrayLike) -> Any:
    """Return the exponential function; see `scalars.exp`."""
    return _fill(_exp, x)


def log(x: ArrayLike) -> Any:
    """Return the natural logarithm; see `scalars.log`."""
    return _fill(_log, x)


def arctan2(y: ArrayLike, x: ArrayLike) -> Any:
    """Return the angle of points (x, y); see `scalars.atan2`."""
    return _fill(_arctan2, y, x)


def power(x: ArrayLike, y: ArrayLike) -> Any:
    """Return the powers of numbers of at least 0; see `scalars.power`."""
    return _fill(_power, x, y)


def hypot(x: ArrayLike, y: ArrayLike) -> Any:
    """Return the length of vectors (x, y); see `scalars.hypot`."""
    return _fill(_hypot, x, y)


def norm(vector: ArrayLike) -> float:
    """Return the length of one vector (N,)."""
    given = np.asarray(vector, np.float64).ravel()
    return float(np.sqrt(np.add.reduce(given * given)))


def matmul(a: ArrayLike, b: ArrayLike) -> Any:
    """Return the matrix product of two arrays of one or more axes, with the shapes of `numpy.matmul`."""
    left, right = np.asarray(a), np.asarray(b)
    inner = "i" if left.ndim == 1 else "...ij"
    if left.ndim == 1:
        subscripts = "i,i->" if right.ndim == 1 else "i,...ij->...j"
    else:
        subscripts = f"{inner},j->...i" if right.ndim == 1 else f"{inner},...jk->...ik"
    return np.einsum(subscripts, left, right)


def convolve(values: ArrayLike, window: ArrayLike) -> Float64:
    """Return the sums (N - M + 1,) of values (N,) weighted by a window (M,) at each place."""
    given, weights = np.asarray(values, np.float64), np.asarray(window, np.float64)
    count = len(given) - len(weights) + 1
    total = np.zeros(count)
    for i, weight in enumerate(weights[::-1]):
        total += weight * given[i : i + count]
    return total


def solve(matrix: ArrayLike, known: ArrayLike) -> Float64:
    """Solve systems of N equations by Gaussian elimination with partial pivoting.

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


def _fill(kernel: Callable[..., None], *arguments: ArrayLike) -> Any:
    given = [np.array(argument, np.float64) for argument in arguments]
    shape = given[0].shape
    # The street calls this for many small arrays, where broadcasting would take longer than the kernel.
    if any(values.shape != shape for values in given):
        shape = np.broadcast_shapes(*(values.shape for values in given))
        given = [np.array(np.broadcast_to(values, shape)) for values in given]
    out = np.empty(shape)
    kernel(out.reshape(-1), *(values.reshape(-1) for values in given))
    return out if out.ndim else out[()]


@per_pixel()
def _sin(out: Float64, x: Float64) -> None:
    for i in range(len(out)):
        out[i] = scalars.sin(x[i])


@per_pixel()
def _cos(out: Float64, x: Float64) -> None:
    for i in range(len(out)):
        out[i] = scalars.cos(x[i])


@per_pixel()
def _tan(out: Float64, x: Float64) -> None:
    for i in range(len(out)):
        out[i] = scalars.tan(x[i])


@per_pixel()
def _arcsin(out: Float64, x: Float64) -> None:
    for i in range(len(out)):
        out[i] = scalars.asin(x[i])


@per_pixel()
def _arccos(out: Float64, x: Float64) -> None:
    for i in range(len(out)):
        out[i] = scalars.acos(x[i])


@per_pixel()
def _exp(out: Float64, x: Float64) -> None:
    for i in range(len(out)):
        out[i] = scalars.exp(x[i])


@per_pixel()
def _log(out: Float64, x: Float64) -> None:
    for i in range(len(out)):
        out[i] = scalars.log(x[i])


@per_pixel()
def _arctan2(out: Float64, y: Float64, x: Float64) -> None:
    for i in range(len(out)):
        out[i] = scalars.atan2(y[i], x[i])


@per_pixel()
def _power(out: Float64, x: Float64, y: Float64) -> None:
    for i in range(len(out)):
        out[i] = scalars.power(x[i], y[i])


@per_pixel()
def _hypot(out: Float64, x: Float64, y: Float64) -> None:
    for i in range(len(out)):
        out[i] = scalars.hypot(x[i], y[i])
