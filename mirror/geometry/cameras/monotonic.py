"""Where a radial distortion stops being invertible, and its inverse up to there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from mirror.arrays import AnyArray, Float64

_CELLS: Final = 4096
_WIDEST_RAD: Final = np.pi / 2 - 1e-6
# A pair of complex roots this close to the real axis is a double root, split by rounding: the slope touches zero.
_REAL_PART: Final = 1e-7
# A root beyond 1e9 focal lengths, or radians, is none.
_LEAST_RECIPROCAL: Final = 1e-9


def first_positive_root(coefficients: Float64) -> float:
    """Return the smallest positive root of a polynomial that is positive at zero; infinity without such a root.

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
    real = reciprocal.real[np.abs(reciprocal.imag) <= _REAL_PART * np.abs(reciprocal)]
    real = real[real > _LEAST_RECIPROCAL]
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
    """A table of first guesses for inverting a function that increases on ``[0, limit)`` by Newton's method."""

    def __init__(self, function: Callable[[AnyArray], AnyArray], limit: float, reach: float = np.inf) -> None:
        """Tabulate the function.

        Args:
            function: of arrays; 0 at 0.
            limit: end of the range; may be infinite.
            reach: the quick table need not go beyond twice this value.
        """
        # Tangents of equal steps: fine near the axis, and still there where a lens bends 90 degrees into the image.
        widest = min(np.arctan(limit), _WIDEST_RAD) * (1.0 - 1e-9)
        self._argument = np.tan(np.linspace(0.0, widest, 4 * _CELLS))
        self._value = np.maximum.accumulate(function(self._argument))
        end = self._value[min(int(np.searchsorted(self._value, 2.0 * reach)), len(self._value) - 1)]
        self._cells_per_value = _CELLS / end
        self._start = np.interp(np.linspace(0.0, end, _CELLS + 1), self._value, self._argument)
        self._slope = np.append(np.diff(self._start), 0.0)

    def quick(self, value: AnyArray) -> AnyArray:
        """Return the arguments whose function values are near ``value``, where this fast search reaches them."""
        position = np.minimum(value * self._cells_per_value, _CELLS)
        cell = position.astype(np.intp)
        position -= cell
        position *= self._slope.take(cell)
        position += self._start.take(cell)
        return np.asarray(position)

    def careful(self, value: AnyArray) -> AnyArray:
        """Return the arguments whose function values are near ``value``, for any slope; 30 times as slow as `quick`."""
        return np.asarray(np.interp(value, self._value, self._argument))
