"""Kernel distance of two sets of features: unbiased at any number of them, with an interval."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from mirror.arrays import AnyArray, Float64, Int64
from mirror.errors import UsageError
from mirror.metrics.features.statistics import checked_features

LARGEST_WHOLE = 4096


@dataclass(frozen=True)
class KernelDistance:
    """A kernel (inception) distance.

    Attributes:
        value: mean over subsets of the unbiased squared maximum mean discrepancy; may be negative.
        deviation: standard deviation over subsets, ddof 0 as torch-fidelity has it.
        interval: of the distance at the wanted level, for the features at hand; NaN where a subset is the whole set.
        level: of the interval.
        subsets: how many subsets were drawn.
        subset_size: features a subset has of either set.
        seed: of the draw.
        n: number of features of both sets.
    """

    value: float
    deviation: float
    interval: tuple[float, float]
    level: float
    subsets: int
    subset_size: int
    seed: int
    n: tuple[int, int]


def kid(
    a: AnyArray,
    b: AnyArray,
    *,
    subsets: int = 100,
    subset_size: int | None = None,
    seed: int = 0,
    level: float = 0.95,
) -> KernelDistance:
    """Return the kernel distance with the kernel (x.y / d + 1)³ of Bińkowski et al., "Demystifying MMD GANs" (2018).

    The interval comes from the spread over subsets drawn without replacement: with n features, subsets of m have
    n / m - 1 times the variance that the whole has (Politis and Romano, 1994, with the correction for finite n).

    Args:
        a: (n, d).
        b: (m, d).
        subsets: how many to draw.
        subset_size: features of each; None: 1000, or half of the smaller set if that is less.
        seed: of the draw; the same seed gives the same figure whatever the number of threads.
        level: of the interval, 0 < level < 1.

    Raises:
        UsageError: dimensions differ, values are not finite, fewer than 2 features, or a subset larger than a set.
    """
    first, second = checked_features(a), checked_features(b)
    if first.shape[1] != second.shape[1]:
        raise UsageError(f"features of {first.shape[1]} and of {second.shape[1]} dimensions")
    if subsets < 1 or not 0.0 < level < 1.0:
        raise UsageError(f"{subsets} subsets, level {level}", expected="at least 1, and 0 < level < 1")
    fewest = min(len(first), len(second))
    size = max(2, min(1000, fewest // 2)) if subset_size is None else subset_size
    if not 2 <= size <= fewest:
        raise UsageError(
            f"subsets of {size} from sets of {len(first)} and {len(second)} features",
            expected=f"2 to {fewest}",
            remedy="score more images or ask for smaller subsets",
        )
    draw = np.random.default_rng(seed)
    whole = max(len(first), len(second)) <= LARGEST_WHOLE
    kernels = (_kernel(first, first), _kernel(second, second), _kernel(first, second)) if whole else None
    values = np.empty(subsets)
    for number in range(subsets):
        i, j = draw.choice(len(first), size, replace=False), draw.choice(len(second), size, replace=False)
        if kernels is None:
            x, y = first[i], second[j]
            values[number] = _discrepancy(_kernel(x, x), _kernel(y, y), _kernel(x, y))
        else:
            values[number] = _discrepancy(*(_part(k, *at) for k, at in zip(kernels, ((i, i), (j, j), (i, j)))))
    value, deviation = float(values.mean()), float(values.std())
    spread = deviation * np.sqrt(size / (fewest - size)) if size < fewest and subsets > 1 else np.nan
    half = NormalDist().inv_cdf(0.5 + level / 2.0) * float(spread)
    n = (len(first), len(second))
    return KernelDistance(value, deviation, (value - half, value + half), level, subsets, size, seed, n)


def _kernel(x: Float64, y: Float64) -> Float64:
    values = x @ y.T
    values /= x.shape[1]
    values += 1.0
    cubed: Float64 = values * values * values
    return cubed


def _part(kernel: Float64, rows: Int64, columns: Int64) -> Float64:
    part: Float64 = kernel[rows][:, columns]
    return part


def _discrepancy(xx: Float64, yy: Float64, xy: Float64) -> float:
    """Unbiased estimate: no sample is compared with itself."""
    pairs = xx.shape[0] * (xx.shape[0] - 1)
    within = (xx.sum() - np.trace(xx) + yy.sum() - np.trace(yy)) / pairs
    return float(within - 2.0 * xy.mean())
