"""Compiled greedy assignment."""

from __future__ import annotations

import numpy as np
from numba import njit

from mirror.arrays import Float64, Int64


@njit(cache=True, nogil=True)
def assign(first: Int64, truth: Int64, distance: Float64, thresholds: Float64, truths: int) -> Int64:
    """Assign to each prediction in turn the nearest true box that no earlier prediction has.

    Args:
        first: (P + 1,) where each prediction's candidates begin; the last entry is their number.
        truth: (K,) the candidates, ascending within a prediction.
        distance: (K,) how far they are.
        thresholds: (T,) distances below which boxes match; each is a pass of its own.
        truths: number of true boxes.

    Returns:
        (T, P) the true box, or -1.
    """
    matched = np.full((len(thresholds), len(first) - 1), -1, dtype=np.int64)
    taken = np.full(truths, -1, dtype=np.int64)
    for step in range(len(thresholds)):
        for prediction in range(len(first) - 1):
            nearest, best = thresholds[step], -1
            for candidate in range(first[prediction], first[prediction + 1]):
                # Of equally near ones the first is taken.
                if distance[candidate] < nearest and taken[truth[candidate]] != step:
                    nearest, best = distance[candidate], truth[candidate]
            if best >= 0:
                taken[best] = step
                matched[step, prediction] = best
    return matched
