"""PSNR after an affine fit of each channel, ``psnr_affine``.

A render of another traversal has another exposure and white balance. Each channel of the render gets its own gain
(0 or more) and offset, by least squares over the pixels that are saturated in neither image. The fitted channel is
clipped to the data range, and PSNR is computed over all selected pixels.

A channel is corrected by nothing but itself. `mirror.metrics.images.colour_correction` (PSNR*) fits each channel to
ten products of all three: a render whose channels hold luma and two ramps gets a better score there than the honest
render, because the fit composes an image from them. Here a ramp is only a worse
channel. Renders can still be recoloured for this fit: the blue channel in all three gained 0.81 dB on one street.
`mirror.metrics.images.invariant` has no such gain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, overload

import numpy as np

from mirror.arrays import Float64
from mirror.metrics.images.affine_kernels import tally_levels
from mirror.metrics.images.colour_correction import SATURATED
from mirror.metrics.images.pairs import ImagePair, as_pairs
from mirror.metrics.inputs import BatchLayout, ImageLayout, Layout, Pixels, of_layout
from mirror.metrics.score import EMPTY_MASK, Score

_LEVELS: Final = 256
# A smaller root mean squared error, as a part of the data range, is rounding.
_ROUNDING: Final = 1e-9
# A smaller variance of a channel, as a part of its mean square, is rounding: the channel is constant.
_LEAST_VARIANCE: Final = 1e-14


@dataclass(frozen=True)
class AffinePsnr:
    """PSNR after an affine fit of each channel.

    Attributes:
        db: the score.
        gains: (C,) gain of each channel, 0 or more.
        offsets: (C,) offset of each channel, as a part of the data range.
    """

    db: Score
    gains: tuple[float, ...]
    offsets: tuple[float, ...]


@overload
def psnr_affine(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: ImageLayout | None = None,
) -> AffinePsnr: ...
@overload
def psnr_affine(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: BatchLayout,
) -> list[AffinePsnr]: ...
def psnr_affine(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: Layout | None = None,
) -> AffinePsnr | list[AffinePsnr]:
    """Return the PSNR of an image after each channel of the render was fitted to the same channel of the truth.

    The gain of a channel whose best gain is negative, or that is constant, is 0: its offset is then the mean of the
    truth. A channel without an unsaturated pixel stays as it is (gain 1, offset 0).

    Args:
        render: (H, W) or (H, W, C), or as ``layout`` says; an array or a torch tensor on the CPU, of uint8, uint16,
            float32 or float64.
        truth: of the same shape and type.
        mask: (H, W) bool, True where pixels count; for a batch also (N, H, W). Other pixels take part in neither fit
            nor score.
        data_range: white minus black; None: 255 or 65535. Floats need it.
        layout: ``hw``, ``hwc`` or ``chw`` of an image, ``nhw``, ``nhwc`` or ``nchw`` of a batch; None: (H, W), or
            arrays (H, W, C). Tensors of more axes need it.

    Returns:
        Score in dB, gains and offsets; for a batch a list with one for each image. The score is infinite if the
        fitted render equals the truth up to rounding, 1e-9 of the range, and NaN with a reason for an empty mask.

    Raises:
        UsageError: the images cannot be compared (`as_pair`), or a selected pixel is NaN or infinite.
    """
    return of_layout([_score(pair) for pair in as_pairs(render, truth, mask, data_range, layout)], layout)


def _score(pair: ImagePair) -> AffinePsnr:
    channels = pair.render.shape[2]
    if pair.empty:
        return AffinePsnr(EMPTY_MASK, (math.nan,) * channels, (math.nan,) * channels)
    fits = _fit_levels(pair) if pair.render.dtype == np.uint8 else _fit_values(pair)
    squared_error = math.fsum(fit.mean_squared_error for fit in fits) / channels
    db = math.inf if squared_error <= _ROUNDING**2 else -10.0 * math.log10(squared_error)
    return AffinePsnr(Score(db), tuple(fit.gain for fit in fits), tuple(fit.offset for fit in fits))


@dataclass(frozen=True)
class _Fit:
    """One channel: gain, offset and mean squared error, as parts of the data range."""

    gain: float
    offset: float
    mean_squared_error: float


def _fit_levels(pair: ImagePair) -> list[_Fit]:
    """Fit 8-bit channels by tallies of the truth at each level of the render: sums of integers, without rounding."""
    channels = pair.render.shape[2]
    tallies = np.zeros((channels, _LEVELS, 5), np.int64)
    tally_levels(np.ascontiguousarray(pair.render), np.ascontiguousarray(pair.truth), pair.mask, tallies)
    return [_fit_tally(tally, pair.data_range) for tally in tallies.tolist()]


def _fit_tally(tally: list[list[int]], data_range: float) -> _Fit:
    """Fit one channel.

    Args:
        tally: for each level of the render: pixels, sum and sum of squares of the truth, and the first two again over
            the pixels that are saturated in neither image.
        data_range: white minus black.
    """
    n = sum(row[3] for row in tally)
    sum_x = sum(level * row[3] for level, row in enumerate(tally))
    sum_y = sum(row[4] for row in tally)
    covariance = n * sum(level * row[4] for level, row in enumerate(tally)) - sum_x * sum_y
    variance = n * sum(level * level * row[3] for level, row in enumerate(tally)) - sum_x * sum_x
    if n == 0:
        gain, offset = 1.0, 0.0
    else:
        gain = max(covariance / variance, 0.0) if variance else 0.0
        offset = (sum_y - gain * sum_x) / n
    errors = []
    for level, (count, total, squares, _, _) in enumerate(tally):
        if count:
            fitted = min(max(gain * level + offset, 0.0), data_range)
            errors += [count * (fitted - total / count) ** 2, (count * squares - total * total) / count]
    pixels = sum(row[0] for row in tally)
    return _Fit(gain, offset / data_range, math.fsum(errors) / pixels / data_range**2)


def _fit_values(pair: ImagePair) -> list[_Fit]:
    pair.refuse_non_finite()
    render, truth = (pair.selected(image).astype(np.float64) / pair.data_range for image in (pair.render, pair.truth))
    return [_fit_channel(render[:, channel], truth[:, channel]) for channel in range(render.shape[1])]


def _fit_channel(render: Float64, truth: Float64) -> _Fit:
    usable = (np.minimum(render, truth) >= SATURATED) & (np.maximum(render, truth) <= 1.0 - SATURATED)
    gain, offset = 1.0, 0.0
    if usable.any():
        x, y = render[usable], truth[usable]
        mean_x, mean_y = float(x.mean()), float(y.mean())
        centred = x - mean_x
        variance = _dot(centred, centred)
        constant = variance <= _LEAST_VARIANCE * _dot(x, x)
        gain = 0.0 if constant else max(_dot(centred, y - mean_y) / variance, 0.0)
        offset = mean_y - gain * mean_x
    difference = np.clip(gain * render + offset, 0.0, 1.0) - truth
    return _Fit(gain, offset, _dot(difference, difference) / len(difference))


def _dot(one: Float64, other: Float64) -> float:
    # Not `@`: the sum of BLAS would depend on its number of threads.
    return float(np.einsum("i,i->", one, other))


def psnr_affine_db(render: Pixels, truth: Pixels, *, mask: Pixels | None = None) -> Score:
    """Return the score of `psnr_affine` of one image, without the gains and offsets."""
    return psnr_affine(render, truth, mask=mask).db
