"""Structure at several scales that a render shares with the truth, ``ms_structure``: the key that ranks renders.

PSNR and SSIM reward renders that show less. On held-out images, whose light differs from the trained light, a flat
colour has a better SSIM than the nearest recorded image, before and after a fit of its colours, and a blur improves the
PSNR of every reconstruction (docs/threat-model.md has the figures). This metric has four defences:

- Only correlation counts: in each window, the score is 0 for a render without structure, whatever its level or
  contrast, and its expectation is 0 for structure that has nothing to do with the truth.
- Each scale is an octave of its own with equal weight. A blur, a sharpening or any other linear filter scales a whole
  octave, which correlation does not see; within an octave little is left to gain.
- Windows are weighed by the truth's structure, so that no render chooses where it is scored.
- Luma has fixed weights. A fit of luma from the channels of a render would compose an image from other images in them.

For the luma of render and truth at one scale, let x and y be what is left after the mean of a gaussian window was
subtracted, and let ``<.>`` be means of another gaussian window. With the correlation

    r = <x y> / sqrt((<x²> + q) (<y²> + q)),

r² is the share of the truth's variance in the window that the best gain of the render explains. The score of the scale
is the mean of ``r |r|`` with weights ``<y²> / (<y²> + C)``, and that of the image is the mean over scales. The next
scale has half the width and height, by means of 2 x 2 pixels. Sums of windows leave out pixels outside the mask.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Final, overload

import cv2
import numpy as np

from mirror.arrays import AnyArray, Float64
from mirror.errors import UsageError
from mirror.metrics.images.pairs import Pair, as_pairs
from mirror.metrics.images.structure_kernels import multiply_bands, sum_scores
from mirror.metrics.inputs import BatchLayout, ImageLayout, Layout, Pixels, of_layout
from mirror.metrics.score import EMPTY_MASK, Score

SCALES: Final = 4
"""Number of octaves."""

LUMA_WEIGHTS: Final = (0.299, 0.587, 0.114)
"""Weights of red, green and blue of ITU-R BT.601."""

BAND_SIGMA_PX: Final = 2.0
"""Standard deviation of the gaussian whose mean is subtracted, in pixels of the scale."""

WINDOW_SIGMA_PX: Final = 3.0
"""Standard deviation of the gaussian over which is correlated, in pixels of the scale."""

WEIGHT_VARIANCE: Final = 0.02**2
"""Variance of the truth, as a part of the squared data range, at which a window has half the weight."""

ROUNDING_VARIANCE: Final = 1.0 / (12.0 * 255.0**2)
"""Variance of the rounding of values in [0, 1] to 8 bits."""

_REACH: Final = 3.0
"""Half the width of a gaussian window, in standard deviations."""

NO_STRUCTURE: Final = "the truth has no structure in the mask"


@overload
def ms_structure(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: ImageLayout | None = None,
) -> Score: ...
@overload
def ms_structure(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: BatchLayout,
) -> list[Score]: ...
def ms_structure(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: Layout | None = None,
) -> Score | list[Score]:
    """Mean share of the truth's local structure that the render explains, over four octaves of luma.

    Args:
        render: (H, W) or (H, W, C) with C of 1 or 3, or as ``layout`` says; an array or a torch tensor on the CPU, of
            uint8, uint16, float32 or float64.
        truth: of the same shape and type.
        mask: (H, W) bool, True where pixels count; for a batch also (N, H, W). Other pixels take part in no window.
        data_range: white minus black; None: 255 or 65535. Floats need it.
        layout: ``hw``, ``hwc`` or ``chw`` of an image, ``nhw``, ``nhwc`` or ``nchw`` of a batch; None: (H, W), or
            arrays (H, W, C). Tensors of more axes need it.

    Returns:
        Score from -1 to 1; for a batch a list with one for each image. About 1 for equal images, 0 for a render
        without structure; NaN with a reason for an empty mask, or if the truth has no structure.

    Raises:
        UsageError: the images cannot be compared (`as_pair`), they have neither 1 nor 3 channels, or a selected pixel
            is NaN or infinite.
    """
    return of_layout([_score(pair) for pair in as_pairs(render, truth, mask, data_range, layout)], layout)


def _score(pair: Pair) -> Score:
    if pair.render.shape[2] not in (1, 3):
        raise UsageError(f"images of {pair.render.shape[2]} channels", expected="1 or 3: luma is needed")
    if pair.empty:
        return EMPTY_MASK
    pair.refuse_non_finite()
    part = _part(pair)
    known = np.ones(pair.render[part].shape[:2]) if pair.mask is None else pair.mask[part].astype(np.float64)
    render, truth = (_luma(image[part], known, pair.data_range) for image in (pair.render, pair.truth))
    scores = [score for score in _scale_scores(render, truth, known) if not math.isnan(score)]
    return Score(math.fsum(scores) / len(scores)) if scores else Score(math.nan, NO_STRUCTURE)


def _part(pair: Pair) -> tuple[slice, slice]:
    """The rows and columns that hold the mask, from and to places that every scale divides."""
    if pair.mask is None:
        return slice(None), slice(None)
    step = 2 ** (SCALES - 1)
    found = []
    for axis in (1, 0):
        places = np.flatnonzero(pair.mask.any(axis=axis))
        found.append(slice(int(places[0]) // step * step, (int(places[-1]) // step + 1) * step))
    return found[0], found[1]


def _luma(image: AnyArray, known: Float64, data_range: float) -> Float64:
    """Luma (H, W) of an image (H, W, C) as a part of the data range, centred on the mean; 0 outside the mask."""
    values = image.astype(np.float64)
    selected = known > 0.0
    # Pixels outside the mask may be NaN.
    if image.dtype.kind == "f":
        values[~selected] = 0.0
    luma = values[..., 0] if image.shape[2] == 1 else cv2.transform(values, np.array([LUMA_WEIGHTS]))
    luma = np.asarray(luma / np.float64(data_range), np.float64)
    luma -= luma[selected].mean()
    luma *= known
    return luma


def _scale_scores(render: Float64, truth: Float64, known: Float64) -> Iterator[float]:
    """Yield the score of each octave, the finest first; NaN where the truth has no structure.

    Args:
        render: (H, W) luma, 0 outside the mask.
        truth: (H, W) luma, 0 outside the mask.
        known: (H, W) 1 in the mask, else 0.
    """
    for scale in range(SCALES):
        if scale:
            render, truth, known = _halve(render, truth, known)
        if not known.any():
            return
        share = _smooth(known, BAND_SIGMA_PX)
        means = [_smooth(image, BAND_SIGMA_PX) for image in (render, truth)]
        products = np.empty((3, *known.shape))
        multiply_bands(render, truth, means[0], means[1], share, known, products[0], products[1], products[2])
        sums = [_smooth(product, WINDOW_SIGMA_PX) for product in products]
        share = _smooth(known, WINDOW_SIGMA_PX)
        score, weight = sum_scores(sums[0], sums[1], sums[2], share, known, ROUNDING_VARIANCE, WEIGHT_VARIANCE)
        yield score / weight if weight > 0.0 else math.nan


def _halve(render: Float64, truth: Float64, known: Float64) -> tuple[Float64, Float64, Float64]:
    """Halve images and mask by means of 2 x 2 pixels, all of which must be in the mask, without an odd last line."""
    height, width = (2 * (size // 2) for size in known.shape)
    parts = [
        image[:height, :width].reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3))
        for image in (render, truth, known)
    ]
    whole = parts[2] == 1.0
    return np.where(whole, parts[0], 0.0), np.where(whole, parts[1], 0.0), whole.astype(np.float64)


def _smooth(image: Float64, sigma_px: float) -> Float64:
    """Filter an image (H, W) with a gaussian window; it is 0 beyond its border."""
    taps = _taps(sigma_px)
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_64F, taps, taps, borderType=cv2.BORDER_CONSTANT))


@lru_cache
def _taps(sigma_px: float) -> Float64:
    reach = math.ceil(_REACH * sigma_px)
    taps = np.exp(-0.5 * np.arange(-reach, reach + 1) ** 2 / sigma_px**2)
    return np.asarray(taps / taps.sum())
