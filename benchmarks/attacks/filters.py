"""The linear filter that gains most in a metric: a sum of gaussian blurs, found by search with the truth at hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from benchmarks.attacks.changes import blur, to_levels
from mirror.arrays import Float64, UInt8

SIGMAS_PX: Final = (0.7, 1.3, 2.2, 4.0, 8.0, 16.0)
_FIRST_STEP: Final = 0.5
_LAST_STEP: Final = 0.06
_LEAST_GAIN: Final = 1e-5


def apply_filter(image: UInt8, shares: Float64) -> UInt8:
    """Filter an image (H, W, 3) by the sum of its blurs with shares (6,), and itself with the rest to 1."""
    return _sum_blurs(_blurs(image), shares)


def find_filter(images: Sequence[UInt8], score: Callable[[int, UInt8], float]) -> Float64:
    """Find the shares of the filter with the best mean score, by a search along each share in turn.

    Args:
        images: (N,) renders (H, W, 3).
        score: score of a filtered image in place of the image of a number.

    Returns:
        (6,) shares of `SIGMAS_PX`; 0 for the unfiltered image.
    """
    blurs = [_blurs(image) for image in images]

    def mean_score(shares: Float64) -> float:
        return float(np.mean([score(place, _sum_blurs(one, shares)) for place, one in enumerate(blurs)]))

    best = np.zeros(len(SIGMAS_PX))
    best_score, step = mean_score(best), _FIRST_STEP
    while step > _LAST_STEP:
        moved = False
        for place in range(len(best)):
            for sign in (1.0, -1.0):
                tried = best.copy()
                tried[place] += sign * step
                found = mean_score(tried)
                if found > best_score + _LEAST_GAIN:
                    best, best_score, moved = tried, found, True
        if not moved:
            step /= 2
    return best


def _blurs(image: UInt8) -> list[Float64]:
    values = image.astype(np.float64)
    return [blur(values, sigma_px) for sigma_px in (0.0, *SIGMAS_PX)]


def _sum_blurs(blurs: Sequence[Float64], shares: Float64) -> UInt8:
    total = (1.0 - shares.sum()) * blurs[0]
    for share, image in zip(shares, blurs[1:]):
        if share:
            total = total + share * image
    return to_levels(total)
