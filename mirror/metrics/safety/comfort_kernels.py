"""Compiled derivatives of samples by local polynomials."""

from __future__ import annotations

import numpy as np

from mirror.arrays import Float64
from mirror.compiled import compiled_above
from mirror.metrics.safety.rectangle_kernels import PLAIN_ELEMENTS


@compiled_above(PLAIN_ELEMENTS)
def local_derivatives(times: Float64, values: Float64, window: int, degree: int, order: int, scale: float) -> Float64:
    """Return the derivatives (T, C) in units of ``scale`` of polynomials fitted to the samples around each time.

    Args:
        times: (T,) increasing times.
        values: (T, C) samples.
        window: number of samples in a window, more than ``degree`` and at most T.
        degree: degree of the polynomials.
        order: order of the derivative.
        scale: times are divided by it, which keeps the powers small and the normal equations well conditioned.
    """
    found = np.empty(values.shape)
    size = degree + 1
    powers = np.empty((window, size))
    gram, right = np.empty((size, size)), np.empty((size, values.shape[1]))
    factorial = 1.0
    for number in range(2, order + 1):
        factorial *= number
    for row in range(len(times)):
        begin = min(max(row - (window - 1) // 2, 0), len(times) - window)
        for sample in range(window):
            power, at = 1.0, (times[begin + sample] - times[row]) / scale
            for column in range(size):
                powers[sample, column] = power
                power *= at
        gram[:], right[:] = 0.0, 0.0
        for sample in range(window):
            for i in range(size):
                for j in range(size):
                    gram[i, j] += powers[sample, i] * powers[sample, j]
                for channel in range(values.shape[1]):
                    right[i, channel] += powers[sample, i] * values[begin + sample, channel]
        # Elimination without pivoting: the matrix is symmetric and positive definite.
        for i in range(size):
            for k in range(i + 1, size):
                factor = gram[k, i] / gram[i, i]
                for j in range(i, size):
                    gram[k, j] -= factor * gram[i, j]
                for channel in range(values.shape[1]):
                    right[k, channel] -= factor * right[i, channel]
        for i in range(size - 1, order - 1, -1):
            for channel in range(values.shape[1]):
                total = right[i, channel]
                for j in range(i + 1, size):
                    total -= gram[i, j] * right[j, channel]
                right[i, channel] = total / gram[i, i]
        for channel in range(values.shape[1]):
            found[row, channel] = factorial * right[order, channel]
    return found
