"""PSNR that no recolouring of a render changes, ``psnr_invariant``: the key of novel views.

A render of another traversal has another light. Every metric that forgives it by a fit can be gained on by a render
that is recoloured for the fit: by the blue channel copied into all three, by a ramp from top to bottom, by luma in one
channel and ramps in the others (docs/threat-model/figures.md has the figures). This metric has three defences:

- The fit maps the truth's colours linearly from all channels of the render, an offset and two ramps, along rows and
  columns. What another recolouring or a ramp could add is given to every render.
- The score is the determinant of the residuals' covariance, not its trace: a render that gives up a channel of colour
  for another signal loses a whole factor of the determinant.
- Which pixels are fitted is the mask's choice alone, so that no level of a render leaves pixels out.

``psnr_invariant = -10 / C log10 det(S + q I)`` with the covariance S (C, C) of the residuals as parts of the data range
and the variance q of rounding to 8 bits. For one channel it is the PSNR after the fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, overload

import numpy as np

from mirror.arrays import AnyArray, Float64, Int64
from mirror.metrics.images.pairs import ROUNDING_VARIANCE, ImagePair, as_pairs
from mirror.metrics.inputs import BatchLayout, ImageLayout, Layout, Pixels, of_layout
from mirror.metrics.score import EMPTY_MASK, Score

_ROWS: Final = 64
# Directions of the regressors below this share of the largest are rounding.
_LEAST_EIGENVALUE: Final = 1e-10


@overload
def psnr_invariant(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: ImageLayout | None = None,
) -> Score: ...
@overload
def psnr_invariant(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: BatchLayout,
) -> list[Score]: ...
def psnr_invariant(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: Layout | None = None,
) -> Score | list[Score]:
    """Return the PSNR of the truth's colours after a linear fit from the render's colours, an offset and two ramps.

    Args:
        render: (H, W) or (H, W, C), or as ``layout`` says; an array or a torch tensor on the CPU, of uint8, uint16,
            float32 or float64.
        truth: of the same shape and type.
        mask: (H, W) bool, True where pixels count; for a batch also (N, H, W).
        data_range: white minus black; None: 255 or 65535. Floats need it.
        layout: ``hw``, ``hwc`` or ``chw`` of an image, ``nhw``, ``nhwc`` or ``nchw`` of a batch; None: (H, W), or
            arrays (H, W, C). Tensors of more axes need it.

    Returns:
        Score in dB; for a batch a list with one for each image. At most 58.9 dB, which equal images have; NaN with a
        reason for an empty mask.

    Raises:
        UsageError: the images cannot be compared (`as_pair`), or a selected pixel is NaN or infinite.
    """
    return of_layout([_score(pair) for pair in as_pairs(render, truth, mask, data_range, layout)], layout)


def _score(pair: ImagePair) -> Score:
    if pair.empty:
        return EMPTY_MASK
    pair.refuse_non_finite()
    channels = pair.render.shape[2]
    # The second moments of render, ramps and truth decide the fit; a common centre keeps their digits.
    size = 2 * channels + 2
    count, sums, moments = 0, np.zeros(size), np.zeros((size, size))
    for columns in _blocks(pair):
        count += len(columns)
        sums += columns.sum(axis=0)
        moments += columns.T @ columns
    covariance = moments / count - np.outer(sums, sums) / count**2
    known, target = slice(0, channels + 2), slice(channels + 2, size)
    residual = covariance[target, target] - _explained(covariance[known, known], covariance[known, target])
    values = np.maximum(np.linalg.eigvalsh(residual), 0.0) + ROUNDING_VARIANCE
    return Score(-10.0 / channels * math.fsum(math.log10(value) for value in values))


def _blocks(pair: ImagePair) -> Iterator[Float64]:
    """Yield render, two ramps and truth of the selected pixels, 64 rows at a time: (N, 2 C + 2), centred on 0.5."""
    height, width = pair.render.shape[:2]
    across = np.linspace(-0.5, 0.5, width)
    down = np.linspace(-0.5, 0.5, height)
    for start in range(0, height, _ROWS):
        rows = slice(start, min(start + _ROWS, height))
        # Selected before they become float64, which is eight times as large.
        places = None if pair.mask is None else np.flatnonzero(pair.mask[rows])
        columns = (
            _relative(_select(pair.render[rows], places), pair.data_range),
            _select(np.broadcast_to(across, (rows.stop - rows.start, width))[..., None], places),
            _select(np.broadcast_to(down[rows, None], (rows.stop - rows.start, width))[..., None], places),
            _relative(_select(pair.truth[rows], places), pair.data_range),
        )
        yield np.concatenate(columns, axis=1)


def _select(values: AnyArray, places: Int64 | None) -> AnyArray:
    """The pixels (N, C) of rows (R, W, C) at places in row-major order; None: all."""
    pixels = values.reshape(-1, values.shape[2])
    return pixels if places is None else pixels.take(places, axis=0)


def _relative(values: AnyArray, data_range: float) -> Float64:
    return np.asarray(values / np.float64(data_range) - 0.5, np.float64)


def _explained(known: Float64, cross: Float64) -> Float64:
    """The part (C, C) of the truth's covariance that the regressors explain.

    Args:
        known: (K, K) covariance of the regressors.
        cross: (K, C) covariance of the regressors with the truth.
    """
    deviations = np.sqrt(np.maximum(np.diagonal(known), 0.0))
    scale = np.divide(1.0, deviations, out=np.zeros_like(deviations), where=deviations > 1e-7)
    values, vectors = np.linalg.eigh(known * scale[:, None] * scale)
    kept = values > _LEAST_EIGENVALUE * max(float(values[-1]), 0.0)
    projected = (vectors[:, kept].T @ (scale[:, None] * cross)) / np.sqrt(values[kept])[:, None]
    return np.asarray(projected.T @ projected)
