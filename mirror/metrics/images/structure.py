"""Structure at several scales that a render shares with the truth, ``ms_structure``: it ranks edits.

`matched_structure` ranks renders by the same sums in another form.

PSNR and SSIM reward renders that show less. On held-out images, whose light differs from the trained light, a flat
colour has a better SSIM than the nearest recorded image, before and after a fit of its colours, and a blur improves the
PSNR of every reconstruction (docs/threat-model/figures.md has the figures). This metric has four defences:

- Only correlation counts: in each window, the score is 0 for a render without structure, whatever its level or
  contrast, and its expectation is 0 for structure that has nothing to do with the truth.
- Each scale is an octave of its own with equal weight. A blur, a sharpening or any other linear filter scales a whole
  octave, which correlation does not see; within an octave little is left to gain.
- Windows are weighed by the truth's structure, so that no render chooses where it is scored.
- In another light, a channel of a render can be nearer to the truth's luma than its luma is: blue has weaker shadows.
  Every render gets the best of its luma and its channels, so that sending one channel in all gains nothing. A fit of
  luma from the channels would compose an image from other images in them.

At one scale, let x be the luma or one channel of the render and y the luma of the truth, after the mean of a gaussian
window was subtracted, and let ``<.>`` be means of another gaussian window. With the correlation

    r = <x y> / sqrt((<x²> + q) (<y²> + q)),

r² is the share of the truth's variance in the window that the best gain of the render explains. The score of the scale
is the mean of ``r |r|`` with weights ``<y²> / (<y²> + C)``. That of the image is the mean over scales, of the best of
luma and channels. The next scale has half the width and height, by means of 2 x 2 pixels. Sums of windows leave out
pixels outside the mask.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, overload

import cv2
import numpy as np

from mirror.arrays import AnyArray, Float64
from mirror.errors import UsageError
from mirror.metrics.images.pairs import ROUNDING_VARIANCE, ImagePair, as_pairs
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

DARK_OFFSET: Final = 0.02
"""What is added to a value, as a part of the data range, before its logarithm is taken."""

_REACH: Final = 3.0
"""Half the width of a gaussian window, in standard deviations."""


@dataclass(frozen=True)
class StructureForm:
    """Settings in which the metrics of structure differ.

    Attributes:
        fine_sigma_px: standard deviation of the gaussian that smooths an octave before its band is taken, in pixels of
            the scale; 0: none, so that the band has all that is finer too.
        least_share: ``r |r|`` up to which a window gains nothing; None: windows gain ``r |r|`` itself.
        has_logarithms: whether a render gets the best of the logarithms of its luma and channels too.
    """

    fine_sigma_px: float = 0.0
    least_share: float | None = None
    has_logarithms: bool = False


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
    """Return the mean share of the local structure of the truth's luma that the render explains, over four octaves.

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
    form = StructureForm()
    return of_layout(
        [score_structure(pair, form) for pair in as_pairs(render, truth, mask, data_range, layout)], layout
    )


def score_structure(pair: ImagePair, form: StructureForm) -> Score:
    """Score the structure that a render shares with the truth.

    Raises:
        UsageError: the images have neither 1 nor 3 channels, or a selected pixel is NaN or infinite.
    """
    if pair.render.shape[2] not in (1, 3):
        raise UsageError(f"images of {pair.render.shape[2]} channels", expected="1 or 3: luma is needed")
    if pair.empty:
        return EMPTY_MASK
    pair.refuse_non_finite()
    part = _part(pair)
    known = np.ones(pair.render[part].shape[:2]) if pair.mask is None else pair.mask[part].astype(np.float64)
    truth = _centred(_luma(pair.truth[part]), known, pair.data_range)
    image = pair.render[part]
    shown = [_luma(image)] if image.shape[2] == 1 else [_luma(image), *np.moveaxis(image, 2, 0)]
    renders = [_centred(values, known, pair.data_range) for values in shown]
    if form.has_logarithms:
        renders += [_centred(_logarithm(values, pair.data_range), known, 1.0) for values in shown]
    scores = list(_scale_scores(renders, truth, known, form))
    return Score(float(np.mean(scores, axis=0).max())) if scores else Score(math.nan, NO_STRUCTURE)


def _part(pair: ImagePair) -> tuple[slice, slice]:
    """The rows and columns that hold the mask, from and to places that every scale divides."""
    if pair.mask is None:
        return slice(None), slice(None)
    step = 2 ** (SCALES - 1)
    found = []
    for axis in (1, 0):
        places = np.flatnonzero(pair.mask.any(axis=axis))
        found.append(slice(int(places[0]) // step * step, (int(places[-1]) // step + 1) * step))
    return found[0], found[1]


def _luma(image: AnyArray) -> AnyArray:
    """Luma (H, W) of an image (H, W, C)."""
    if image.shape[2] == 1:
        return image[..., 0]
    return np.asarray(cv2.transform(image.astype(np.float64), np.array([LUMA_WEIGHTS])))


def _centred(values: AnyArray, known: Float64, data_range: float) -> Float64:
    """Values (H, W) as parts of the data range, centred on their mean; 0 outside the mask, where they may be NaN."""
    selected = known > 0.0
    relative = np.where(selected, values, 0.0) / np.float64(data_range)
    return np.asarray((relative - relative.sum() / known.sum()) * known)


def _logarithm(values: AnyArray, data_range: float) -> Float64:
    """Take the logarithm of values (H, W) as parts of the data range, with an offset that spares dark noise."""
    return np.asarray(np.log(np.maximum(values / np.float64(data_range), 0.0) + DARK_OFFSET))


def _scale_scores(
    renders: Sequence[Float64], truth: Float64, known: Float64, form: StructureForm
) -> Iterator[list[float]]:
    """Yield the scores of each render in an octave, the finest first; none where the truth has no structure.

    Args:
        renders: (N,) values (H, W), 0 outside the mask.
        truth: (H, W) luma, 0 outside the mask.
        known: (H, W) 1 in the mask, else 0.
        form: of the metric.
    """
    least_share = -1.0 if form.least_share is None else form.least_share
    for scale in range(SCALES):
        if scale:
            whole = _halve(known) == 1.0
            truth, known = np.where(whole, _halve(truth), 0.0), whole.astype(np.float64)
            renders = [np.where(whole, _halve(render), 0.0) for render in renders]
        if not known.any():
            return
        band_share, share = _smooth(known, BAND_SIGMA_PX), _smooth(known, WINDOW_SIGMA_PX)
        fine_share, fine_truth = (_smooth_fine(image, form) for image in (known, truth))
        smooth_truth = _smooth(truth, BAND_SIGMA_PX)
        true_squares: Float64 | None = None
        products = np.empty((3, *known.shape))
        scores = []
        for render in renders:
            fine_render, smooth_render = _smooth_fine(render, form), _smooth(render, BAND_SIGMA_PX)
            multiply_bands(
                fine_render, fine_truth, fine_share, smooth_render, smooth_truth, band_share, known,
                products[0], products[1], products[2],
            )  # fmt: skip
            if true_squares is None:
                true_squares = _smooth(products[1], WINDOW_SIGMA_PX)
            squares, cross = _smooth(products[0], WINDOW_SIGMA_PX), _smooth(products[2], WINDOW_SIGMA_PX)
            score, weight = sum_scores(
                squares, true_squares, cross, share, known, ROUNDING_VARIANCE, WEIGHT_VARIANCE, least_share
            )
            if weight > 0.0:
                scores.append(score / weight)
        if scores:
            yield scores


def _smooth_fine(image: Float64, form: StructureForm) -> Float64:
    return _smooth(image, form.fine_sigma_px) if form.fine_sigma_px > 0.0 else image


def _halve(image: Float64) -> Float64:
    """Halve an image (H, W) by means of 2 x 2 pixels, without an odd last line."""
    height, width = (2 * (size // 2) for size in image.shape)
    return np.asarray(image[:height, :width].reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3)))


def _smooth(image: Float64, sigma_px: float) -> Float64:
    """Filter an image (H, W) with a gaussian window; it is 0 beyond its border."""
    taps = _taps(sigma_px)
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_64F, taps, taps, borderType=cv2.BORDER_CONSTANT))


@lru_cache
def _taps(sigma_px: float) -> Float64:
    reach = math.ceil(_REACH * sigma_px)
    taps = np.exp(-0.5 * np.arange(-reach, reach + 1) ** 2 / sigma_px**2)
    return np.asarray(taps / taps.sum())
