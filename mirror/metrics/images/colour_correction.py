"""PSNR after colour correction, ``psnr_cc``: our reading of the paper's PSNR*.

A render of another traversal has another exposure and white balance. MTGS, and multinerf before it, warp the render's
colours to the photograph's by a quadratic polynomial of RGB that is fitted five times, each time leaving out pixels
that are saturated in the render, in the photograph or in the warped render; then PSNR is taken of all pixels.

The fits are least squares by blocked normal equations in float64. They are set up in colours that are centred and
decorrelated, which changes no fit (an affine change of colours maps quadratic polynomials to quadratic polynomials)
but keeps the equations well-conditioned for nearly grey images. The solution is the one of least norm among the
polynomial's own coefficients: where the colours of an image do not determine all ten, `CorrectedPsnr.rank` says so.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, overload

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.compiled import compiles_always
from mirror.errors import UsageError
from mirror.metrics.images.colour_kernels import add_equations, measure_spread, warp_colours
from mirror.metrics.images.pairs import ImagePair, as_pair, as_pairs
from mirror.metrics.images.psnr import decibels
from mirror.metrics.inputs import BatchLayout, ImageLayout, Layout, Pixels, as_array, as_image, of_layout
from mirror.metrics.score import Score

ITERATIONS: Final = 5
SATURATED: Final = 0.5 / 255.0

_BLOCK: Final = 8192
_LARGE: Final = _BLOCK + 1
"""RGB images with as many pixels are fitted by compiled kernels: a smaller one does not pay for compiling them."""
# Directions of colour whose variance is below this share of the largest are rounding; so are singular values.
_LEAST_VARIANCE: Final = 1e-13
_LEAST_EIGENVALUE: Final = 1e-12
_ROUNDING: Final = 1e-9


@dataclass(frozen=True)
class Correction:
    """A render in the colours of its photograph.

    Attributes:
        colours: (N, C) of the selected pixels, row by row, as parts of the data range.
        ranks: (iterations, C) rank of each channel's fit; 0: every pixel of the channel is saturated, and its warp is
            black.
        terms: coefficients of a channel, 10 for RGB: the full rank.
    """

    colours: Float64
    ranks: Int64
    terms: int


@dataclass(frozen=True)
class CorrectedPsnr:
    """The PSNR of an image after colour correction, and the rank of the correction.

    Attributes:
        db: the score.
        rank: the least rank of its fits.
        terms: the full rank.
    """

    db: Score
    rank: int
    terms: int

    @property
    def full_rank(self) -> bool:
        """Return whether the image's colours determine the warp."""
        return self.rank == self.terms


@overload
def psnr_cc(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    iterations: int = ITERATIONS,
    layout: ImageLayout | None = None,
) -> CorrectedPsnr: ...
@overload
def psnr_cc(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    iterations: int = ITERATIONS,
    layout: BatchLayout,
) -> list[CorrectedPsnr]: ...
def psnr_cc(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    iterations: int = ITERATIONS,
    layout: Layout | None = None,
) -> CorrectedPsnr | list[CorrectedPsnr]:
    """Return the PSNR of an image after its colours were warped to the photograph's.

    Args:
        render: (H, W, C), RGB as a rule, or as ``layout`` says; an array or a torch tensor on the CPU, of uint8,
            uint16, float32 or float64.
        truth: of the same shape and type.
        mask: (H, W) bool, true where pixels count; of a batch also (N, H, W). The others take part in neither fit nor
            score.
        data_range: what separates black from white; None: 255 or 65535. Floats need it.
        iterations: number of fits; MTGS has 5.
        layout: ``hw``, ``hwc`` or ``chw`` of an image, ``nhw``, ``nhwc`` or ``nchw`` of a batch; None: (H, W), or
            arrays (H, W, C). Tensors of more axes need it.

    Returns:
        dB and the rank of the fits; of a batch a list, one an image. Infinite for equal images, and where the warp
        meets the photograph to rounding, 1e-9 of the range at every pixel: what is left then is the fit's own noise,
        which no mean should contain.

    Raises:
        UsageError: as of `correct_colours`.
    """
    pairs = as_pairs(render, truth, mask, data_range, layout)
    return of_layout([_corrected_psnr(pair, iterations) for pair in pairs], layout)


def _corrected_psnr(pair: ImagePair, iterations: int) -> CorrectedPsnr:
    correction = _correct(pair, iterations)
    target = pair.selected(pair.truth).astype(np.float64) / pair.data_range
    difference = (correction.colours - target).reshape(-1)
    equal = np.array_equal(pair.selected(pair.render), pair.selected(pair.truth))
    if equal or max(float(difference.max()), -float(difference.min())) <= _ROUNDING:
        score = Score(math.inf)
    else:
        # Not `@`: BLAS would start threads for a sum of this length.
        score = decibels(float(np.einsum("i,i->", difference, difference)), len(difference))
    return CorrectedPsnr(score, int(correction.ranks.min()), correction.terms)


def correct_colours(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    iterations: int = ITERATIONS,
    layout: ImageLayout | None = None,
) -> Correction:
    """Warp a render's colours to its photograph's.

    Args:
        render: as of `psnr_cc`.
        truth: as of `psnr_cc`.
        mask: as of `psnr_cc`.
        data_range: as of `psnr_cc`.
        iterations: as of `psnr_cc`.
        layout: of the images.

    Returns:
        The warped colours, clipped to the data range, and the ranks.

    Raises:
        UsageError: the images cannot be compared (`as_pair`), a selected pixel is NaN or infinite, the mask selects
            none, or there is no iteration.
    """
    images = as_image(render, "render", layout), as_image(truth, "truth", layout)
    return _correct(as_pair(*images, None if mask is None else as_array(mask, "mask"), data_range), iterations)


def _correct(pair: ImagePair, iterations: int) -> Correction:
    if pair.empty:
        raise UsageError("the mask selects no pixel to fit colours to", expected="at least one")
    if iterations < 1:
        raise UsageError(f"{iterations} iterations", expected="at least 1")
    pair.refuse_non_finite()
    # Channels first, so that each term of a block is contiguous.
    colours, target = (
        np.ascontiguousarray(pair.selected(image).T, dtype=np.float64) / pair.data_range
        for image in (pair.render, pair.truth)
    )
    usable = _unsaturated(colours) & _unsaturated(target)
    spread = _Spread.of(colours)
    ranks = []
    for _ in range(iterations):
        warp, rank = _fit(colours, target, usable, spread)
        ranks.append(rank)
        spread = _apply(colours, warp)
    return Correction(np.ascontiguousarray(colours.T), np.array(ranks), warp.shape[1])


@dataclass(frozen=True)
class _Spread:
    """Mean (C,) and covariance (C, C) of colours."""

    mean: Float64
    covariance: Float64

    @staticmethod
    def of(colours: Float64) -> _Spread:
        if _is_large(colours):
            spread = _Spread(np.empty(3), np.empty((3, 3)))
            measure_spread(colours, spread.mean, spread.covariance)
            return spread
        mean = colours.mean(axis=1)
        centred = colours - mean[:, None]
        return _Spread(mean, centred @ centred.T / colours.shape[1])

    def whitening(self) -> tuple[Float64, Float64]:
        """Matrices (C, C) to colours of unit variance and back; directions without variance become zero."""
        variances, axes = np.linalg.eigh(self.covariance)
        deviations = np.sqrt(np.maximum(variances, 0.0))
        varied = variances > max(_LEAST_VARIANCE * variances[-1], _LEAST_VARIANCE**2)
        inverse = np.divide(1.0, deviations, out=np.zeros_like(deviations), where=varied)
        return inverse[:, None] * axes.T, axes * np.where(varied, deviations, 0.0)


def _fit(colours: Float64, target: Float64, usable: Bool, spread: _Spread) -> tuple[Float64, list[int]]:
    """Coefficients (C, terms) of each channel's warp, and their ranks."""
    whiten, unwhiten = spread.whitening()
    channels, terms = len(colours), _terms(len(colours))
    gram, moments = np.zeros((channels, terms, terms)), np.zeros((channels, terms))
    if _is_large(colours):
        add_equations(colours, target, usable, SATURATED, whiten, spread.mean, gram, moments)
    for block in _blocks(0 if _is_large(colours) else colours.shape[1]):
        features = _expand(whiten @ (colours[:, block] - spread.mean[:, None]))
        fits = usable[:, block] & _unsaturated(colours[:, block])
        everywhere = fits.all(axis=0)
        whole = features * everywhere
        gram += whole @ features.T
        moments += target[:, block] @ whole.T
        some = np.flatnonzero(fits.any(axis=0) & ~everywhere)
        if len(some):
            few = features[:, some]
            for channel in range(channels):
                weighted = few * fits[channel, some]
                gram[channel] += weighted @ few.T
                moments[channel] += weighted @ target[channel, block][some]
    lift = _lift(unwhiten, spread.mean)
    warps, ranks = zip(*(_least_norm(gram[channel], moments[channel], lift) for channel in range(channels)))
    return np.stack(warps), list(ranks)


def _least_norm(gram: Float64, moments: Float64, lift: Float64) -> tuple[Float64, int]:
    """Of all coefficients that fit best, those of least norm, in the terms of unwhitened colours; and the rank.

    Args:
        gram: (T, T) of whitened terms.
        moments: (T,) of whitened terms with the target.
        lift: (T, T) from whitened terms to terms.
    """
    sizes = np.sqrt(np.diagonal(gram))
    scale = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=sizes > 0)
    values, vectors = np.linalg.eigh(gram * scale[:, None] * scale)
    kept = values > _LEAST_EIGENVALUE * max(float(values[-1]), 0.0)
    if not kept.any():
        return np.zeros(len(gram)), 0
    vectors, values = vectors[:, kept], values[kept]
    # Each pixel's terms are lift @ (sizes * vectors) times something: coefficients of least norm lie in that span.
    span, triangle = np.linalg.qr(lift @ (sizes[:, None] * vectors))
    return span @ np.linalg.solve(triangle.T, (vectors.T @ (scale * moments)) / values), len(values)


def _apply(colours: Float64, warp: Float64) -> _Spread:
    """Warp colours in place; their new spread."""
    if _is_large(colours):
        warp_colours(colours, np.ascontiguousarray(warp))
        return _Spread.of(colours)
    for block in _blocks(colours.shape[1]):
        np.clip(warp @ _expand(colours[:, block]), 0.0, 1.0, out=colours[:, block])
    return _Spread.of(colours)


def _expand(colours: Float64) -> Float64:
    """Terms (T, N) of colours (C, N): products, the colours, one."""
    channels = len(colours)
    terms = np.empty((_terms(channels), colours.shape[1]))
    row = 0
    for channel in range(channels):
        following = channels - channel
        np.multiply(colours[channel], colours[channel:], out=terms[row : row + following])
        row += following
    terms[row:-1] = colours
    terms[-1] = 1.0
    return terms


def _lift(matrix: Float64, shift: Float64) -> Float64:
    """The (T, T) matrix L with ``_expand(matrix @ u + shift) == L @ _expand(u)`` for all u."""
    channels = len(shift)
    first, second = np.triu_indices(channels)
    products = np.einsum("ki,kj->kij", matrix[first], matrix[second])
    symmetric = products + products.transpose(0, 2, 1)
    symmetric[:, range(channels), range(channels)] *= 0.5
    lift = np.zeros((_terms(channels), _terms(channels)))
    quadratic, linear = slice(len(first)), slice(len(first), -1)
    lift[quadratic, quadratic] = symmetric[:, first, second]
    lift[quadratic, linear] = shift[first, None] * matrix[second] + shift[second, None] * matrix[first]
    lift[quadratic, -1] = shift[first] * shift[second]
    lift[linear, linear] = matrix
    lift[linear, -1] = shift
    lift[-1, -1] = 1.0
    return lift


def _is_large(colours: Float64) -> bool:
    """Return whether compiled kernels compute with colours (C, N)."""
    return len(colours) == 3 and (colours.shape[1] >= _LARGE or compiles_always())


def _unsaturated(colours: Float64) -> Bool:
    return (colours >= SATURATED) & (colours <= 1.0 - SATURATED)


def _terms(channels: int) -> int:
    return (channels + 1) * (channels + 2) // 2


def _blocks(count: int) -> Iterator[slice]:
    for start in range(0, count, _BLOCK):
        yield slice(start, start + _BLOCK)
