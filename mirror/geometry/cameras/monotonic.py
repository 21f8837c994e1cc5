"""Where a radial distortion stops being invertible, and its inverse up to there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from mirror.arrays import AnyArray, Float64

_CELLS: Final = 4096
_REAL_PART: Final = 1e-7


def first_positive_root(coefficients: Float64) -> float:
    """The smallest positive root of a polynomial that is positive at zero; infinity if there is none.

    Args:
        coefficients: (D + 1,) ascending, the first positive.
    """
    # The reciprocals of the roots are eigenvalues of a companion matrix whose entries are the coefficients over the
    # first: vanishing leading coefficients do no harm, and the smallest root is the best determined.
    degree = len(coefficients) - 1
    if degree < 1:
        return np.inf
    companion = np.eye(degree, k=-1)
    companion[0] = -coefficients[1:] / coefficients[0]
    reciprocal = np.linalg.eigvals(companion)
    real = reciprocal.real[(np.abs(reciprocal.imag) <= _REAL_PART * np.abs(reciprocal)) & (reciprocal.real > 0)]
    if not len(real):
        return np.inf
    return _polish(np.polynomial.Polynomial(coefficients), float(1.0 / real.max()))


def _polish(polynomial: np.polynomial.Polynomial, root: float) -> float:
    slope = polynomial.deriv()
    for _ in range(4):
        gradient = float(slope(root))
        if gradient == 0.0:
            break
        better = root - float(polynomial(root)) / gradient
        if not abs(polynomial(better)) < abs(polynomial(root)):
            break
        root = better
    return root


class InverseTable:
    """First guesses for the inverse of an increasing function on ``[0, end]``, to start Newton's method from."""

    def __init__(self, function: Callable[[AnyArray], AnyArray], end: float) -> None:
        # Tangents of equal steps: fine near the axis, and still there where a lens bends 90 degrees into the image.
        argument = np.tan(np.linspace(0.0, np.arctan(end), 4 * _CELLS))
        value = np.maximum.accumulate(function(argument))
        self._cells_per_value = _CELLS / value[-1]
        self._argument = np.interp(np.linspace(0.0, value[-1], _CELLS + 1), value, argument)
        self._slope = np.append(np.diff(self._argument), 0.0)

    def __call__(self, value: AnyArray) -> AnyArray:
        """Arguments whose function values are near ``value``; the end where it is greater."""
        position = np.minimum(value * self._cells_per_value, _CELLS)
        cell = position.astype(np.intp)
        position -= cell
        position *= self._slope.take(cell)
        position += self._argument.take(cell)
        return np.asarray(position)
