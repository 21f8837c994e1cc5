"""How sure a mean is: bootstrap intervals and paired comparisons that resample blocks of consecutive frames.

Neighbouring frames, and the cameras of one frame, show the same things: their scores are not independent, and
resampling them one by one gives intervals that are too narrow. Blocks are what is drawn here; `frame_blocks` makes
them. Intervals are Efron's: percentile, or bias-corrected and accelerated (BCa; Efron 1987) with the jackknife over
blocks. The p-value of a difference is that of flipping the signs of whole blocks, exact where the flips can be counted
out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final, Literal, TypeAlias

import numpy as np

from mirror.arrays import AnyArray, Float64, Int64
from mirror.errors import UsageError
from mirror.metrics.inputs import Numbers, as_numbers

Method: TypeAlias = Literal["bca", "percentile"]

RESAMPLES: Final = 10_000
CONFIDENCE: Final = 0.95

_TOO_FEW: Final = "fewer than two blocks of finite scores"
_CHUNK: Final = 1 << 20
_NORMAL: Final = NormalDist()


@dataclass(frozen=True)
class Interval:
    """A mean with its confidence interval.

    Attributes:
        mean: of the finite scores; NaN if there is none.
        low: lower end; NaN where there is a reason.
        high: upper end; NaN where there is a reason.
        n: finite scores.
        n_dropped: scores that are NaN or infinite, and in neither mean nor interval.
        n_blocks: blocks of finite scores, the units that are drawn.
        reason: why there is no interval; None where there is one.
    """

    mean: float
    low: float
    high: float
    n: int
    n_dropped: int
    n_blocks: int
    reason: str | None


@dataclass(frozen=True)
class Difference:
    """The mean difference of two methods on the same images, with its interval and p-value.

    Attributes:
        interval: of the mean difference, first less second, over images where both scores are finite.
        p_value: how often flipping the signs of blocks gives a mean difference as large, two-sided; NaN without an
            interval.
    """

    interval: Interval
    p_value: float


def frame_blocks(sequences: Sequence[object], frames: Numbers, length: int) -> Int64:
    """Number blocks of consecutive frames; all images of a frame are in one block.

    Args:
        sequences: what each image belongs to, a traversal as a rule. No block spans two.
        frames: (N,) time or number of each image's frame within its sequence. Only their order counts.
        length: frames in a block; a sequence's last block may have fewer. A block should be longer than scores stay
            alike: a few seconds of driving.

    Returns:
        (N,) block of each image, counted from 0.

    Raises:
        UsageError: lengths differ, or the length is below 1.
    """
    frames = np.asarray(frames)
    if frames.shape != (len(sequences),) or length < 1:
        raise UsageError(
            f"{len(sequences)} sequences, frames {frames.shape}, blocks of {length}",
            expected="a frame each, length > 0",
        )
    numbers = {sequence: number for number, sequence in enumerate(dict.fromkeys(sequences))}
    members = np.array([numbers[sequence] for sequence in sequences], np.int64)
    blocks, used = np.zeros(len(frames), np.int64), 0
    for number in range(len(numbers)):
        mine = np.flatnonzero(members == number)
        blocks[mine] = used + np.unique(frames[mine], return_inverse=True)[1] // length
        used = int(blocks[mine].max()) + 1
    return blocks


def mean_interval(
    scores: Numbers,
    blocks: Numbers,
    *,
    method: Method = "bca",
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Interval:
    """Return the interval of the mean of scores.

    Args:
        scores: (N,) one an image.
        blocks: (N,) integers, what is resampled together: `frame_blocks`. ``range(N)`` resamples single images.
        method: ``bca`` or ``percentile``.
        confidence: probability that the interval is to hold the mean, in (0, 1).
        resamples: number of draws.
        seed: of the draws; equal arguments give equal results.

    Returns:
        The interval; without ends, and with a reason, for fewer than two blocks.

    Raises:
        UsageError: lengths differ or an option is out of its range.
    """
    scores, blocks = _checked(scores, blocks, method, confidence, resamples)
    finite = np.isfinite(scores)
    n, dropped = int(finite.sum()), int((~finite).sum())
    mean = math.fsum(scores[finite]) / n if n else math.nan
    # About the mean, so that an offset costs the resampled figures no digits.
    sums, counts = _block_sums(scores[finite] - mean, blocks[finite])
    if len(sums) < 2:
        return Interval(mean, math.nan, math.nan, n, dropped, len(sums), _TOO_FEW)
    means = np.sort(_drawn_means(sums, counts, resamples, np.random.default_rng(seed)))
    tail = 0.5 * (1.0 - confidence)
    ends = (tail, 1.0 - tail)
    if method == "bca":
        ends = _bca_levels(means, _left_out_means(sums, counts), ends)
    low, high = (mean + float(np.quantile(means, end)) for end in ends)
    return Interval(mean, low, high, n, dropped, len(sums), None)


def paired_difference(
    first: Numbers,
    second: Numbers,
    blocks: Numbers,
    *,
    method: Method = "bca",
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Difference:
    """Compare two methods by their scores of the same images.

    Args:
        first: (N,) scores of one.
        second: (N,) scores of the other, image by image. Images where either is not finite are dropped and counted.
        blocks: (N,) as of `mean_interval`.
        method: as of `mean_interval`.
        confidence: as of `mean_interval`.
        resamples: draws of the interval, and flips of the test where there are more of them.
        seed: as of `mean_interval`.

    Returns:
        The interval of the mean difference and its p-value.

    Raises:
        UsageError: as of `mean_interval`.
    """
    first, second = as_numbers(first, "first scores", np.float64), as_numbers(second, "second scores", np.float64)
    if first.shape != second.shape:
        raise UsageError(f"scores {first.shape} and {second.shape}", expected="scores of the same images")
    with np.errstate(invalid="ignore"):
        difference = first - second
    difference[~(np.isfinite(first) & np.isfinite(second))] = np.nan
    interval = mean_interval(difference, blocks, method=method, confidence=confidence, resamples=resamples, seed=seed)
    if interval.reason is not None:
        return Difference(interval, math.nan)
    finite = np.isfinite(difference)
    sums, _ = _block_sums(difference[finite], as_numbers(blocks, "blocks")[finite])
    return Difference(interval, _sign_flip_p_value(sums, resamples, np.random.default_rng(seed)))


def _checked(
    scores: Numbers, blocks: Numbers, method: str, confidence: float, resamples: int
) -> tuple[Float64, AnyArray]:
    scores, blocks = as_numbers(scores, "scores", np.float64), as_numbers(blocks, "blocks")
    if scores.ndim != 1 or blocks.shape != scores.shape or (blocks.size and blocks.dtype.kind not in "iu"):
        raise UsageError(
            f"scores {scores.shape}, blocks {blocks.shape} of {blocks.dtype}", expected="an integer for each score"
        )
    if method not in ("bca", "percentile") or not 0.0 < confidence < 1.0 or resamples < 1:
        raise UsageError(
            f"method {method!r}, confidence {confidence}, {resamples} resamples",
            expected="bca or percentile, a confidence between 0 and 1, at least one draw",
        )
    return scores, blocks


def _block_sums(scores: Float64, blocks: AnyArray) -> tuple[Float64, Float64]:
    """Sum and count of each block's scores."""
    _, member = np.unique(blocks, return_inverse=True)
    return np.bincount(member, scores).astype(np.float64), np.bincount(member).astype(np.float64)


def _in_chunks(rows: int, columns: int, draw: Callable[[int], Float64]) -> Float64:
    """Concatenate draws of some rows each, so that memory stays small."""
    step = max(1, _CHUNK // columns)
    return np.concatenate([draw(min(step, rows - start)) for start in range(0, rows, step)])


def _drawn_means(sums: Float64, counts: Float64, resamples: int, rng: np.random.Generator) -> Float64:
    def draw(rows: int) -> Float64:
        chosen = rng.integers(len(sums), size=(rows, len(sums)))
        return sums[chosen].sum(axis=1) / counts[chosen].sum(axis=1)

    return _in_chunks(resamples, len(sums), draw)


def _left_out_means(sums: Float64, counts: Float64) -> Float64:
    """Means without each block in turn."""
    return (sums.sum() - sums) / (counts.sum() - counts)


def _bca_levels(means: Float64, left_out: Float64, ends: tuple[float, float]) -> tuple[float, float]:
    """Quantiles that correct for bias and skewness; ``means`` are sorted and about the sample's."""
    below = np.searchsorted(means, 0.0, "left") + np.searchsorted(means, 0.0, "right")
    share = float(below) / (2 * len(means))
    # All draws on one side of the sample's mean: as far as this many draws can tell.
    bias = _NORMAL.inv_cdf(min(max(share, 0.5 / len(means)), 1.0 - 0.5 / len(means)))
    deviations = left_out.mean() - left_out
    spread = float(np.sum(deviations**2)) ** 1.5
    acceleration = float(np.sum(deviations**3)) / (6.0 * spread) if spread > 0.0 else 0.0

    def level(end: float) -> float:
        shifted = bias + _NORMAL.inv_cdf(end)
        stretch = 1.0 - acceleration * shifted
        # One block far off the others: the correction runs past the last draw.
        return _NORMAL.cdf(bias + shifted / stretch) if stretch > 0.0 else float(shifted > 0.0)

    return level(ends[0]), level(ends[1])


def _sign_flip_p_value(sums: Float64, resamples: int, rng: np.random.Generator) -> float:
    observed = abs(float(sums.sum()))
    # Sums that differ by rounding alone are as large as the observed one.
    least = observed - 1e-12 * float(np.abs(sums).sum())
    count = len(sums)
    if count <= math.log2(resamples):
        flips = (np.arange(1 << count)[:, None] >> np.arange(count)) & 1
        return float(np.mean(np.abs((1 - 2 * flips) @ sums) >= least))

    def draw(rows: int) -> Float64:
        signs = 1.0 - 2.0 * rng.integers(2, size=(rows, count))
        return np.abs(signs @ sums)

    return (1.0 + float(np.sum(_in_chunks(resamples, count, draw) >= least))) / (resamples + 1.0)
