"""Peak signal-to-noise ratio: of an image, the mean over images, and of the pooled squared error.

``PSNR = 10 log10(data_range² / MSE)`` with the mean over the selected pixels and all channels. uint8 images are
compared in integers, others in float64. Equal images have infinite PSNR, which no mean contains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, overload

import cv2
import numpy as np

from mirror.arrays import AnyArray
from mirror.errors import UsageError
from mirror.metrics.images.aggregate import Summary, summarise
from mirror.metrics.images.pairs import ImagePair, as_pairs
from mirror.metrics.inputs import BatchLayout, ImageLayout, Layout, Pixels, of_layout
from mirror.metrics.score import EMPTY_MASK, Score

_BLOCK: Final = 1 << 16


@overload
def psnr(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: ImageLayout | None = None,
) -> Score: ...
@overload
def psnr(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: BatchLayout,
) -> list[Score]: ...
def psnr(
    render: Pixels,
    truth: Pixels,
    *,
    mask: Pixels | None = None,
    data_range: float | None = None,
    layout: Layout | None = None,
) -> Score | list[Score]:
    """Return the PSNR of an image in dB.

    Args:
        render: (H, W) or (H, W, C), or as ``layout`` says; an array or a torch tensor on the CPU, of uint8, uint16,
            float32 or float64.
        truth: of the same shape and type.
        mask: (H, W) bool, true where pixels count; of a batch also (N, H, W). They are selected: nothing is filled with
            zeros.
        data_range: what separates black from white; None: 255 or 65535. Floats need it.
        layout: ``hw``, ``hwc`` or ``chw`` of an image, ``nhw``, ``nhwc`` or ``nchw`` of a batch; None: (H, W), or
            arrays (H, W, C). Tensors of more axes need it.

    Returns:
        dB; of a batch a list, one an image. Infinite for equal images, NaN with a reason for an empty mask. Float
        images that differ by less than 1e-154 of the range count as equal.

    Raises:
        UsageError: the images cannot be compared (`as_pair`), or a selected pixel is NaN or infinite.
    """
    pairs = as_pairs(render, truth, mask, data_range, layout)
    return of_layout([decibels(*_relative_squares(pair)) for pair in pairs], layout)


@dataclass(frozen=True)
class PsnrSummary:
    """The PSNR of many images: mean, pooled value and counts.

    Attributes:
        images: counts, and the mean of PSNR over images.
        pooled: PSNR of the mean squared error over all pixels of all images, as torchmetrics' ``PeakSignalNoiseRatio``
            has it: lower, since the worst images rule it.
    """

    images: Summary
    pooled: Score


class Psnr:
    """An accumulator of PSNR.

    Args:
        data_range: as of `psnr`.
    """

    def __init__(self, data_range: float | None = None) -> None:
        self.data_range = data_range
        self.scores: list[Score] = []
        self._squares: list[float] = []
        self._count = 0

    @overload
    def update(
        self, render: Pixels, truth: Pixels, mask: Pixels | None = None, *, layout: ImageLayout | None = None
    ) -> Score: ...
    @overload
    def update(
        self, render: Pixels, truth: Pixels, mask: Pixels | None = None, *, layout: BatchLayout
    ) -> list[Score]: ...
    def update(
        self, render: Pixels, truth: Pixels, mask: Pixels | None = None, *, layout: Layout | None = None
    ) -> Score | list[Score]:
        """Add an image or a batch; see `psnr` for arguments, result and errors."""
        parts = [_relative_squares(pair) for pair in as_pairs(render, truth, mask, self.data_range, layout)]
        scores = [decibels(*part) for part in parts]
        self.scores.extend(scores)
        self._squares.extend(squares for squares, _ in parts)
        self._count += sum(count for _, count in parts)
        return of_layout(scores, layout)

    def merge(self, other: Psnr) -> None:
        """Add the images of another accumulator.

        Raises:
            UsageError: its data range is another.
        """
        if other.data_range != self.data_range:
            raise UsageError(f"data ranges {self.data_range} and {other.data_range}", expected="one range")
        self.scores.extend(other.scores)
        self._squares.extend(other._squares)
        self._count += other._count

    def compute(self) -> PsnrSummary:
        """Return the summary so far, which does not depend on the order of images."""
        pooled = decibels(math.fsum(self._squares), self._count) if self.scores else summarise([]).mean
        return PsnrSummary(summarise(self.scores), pooled)


def _relative_squares(pair: ImagePair) -> tuple[float, int]:
    """Sum of squared differences as parts of the range, and their number."""
    if pair.render.dtype == np.uint8:
        mask = None if pair.mask is None else np.ascontiguousarray(pair.mask).view(np.uint8)
        squares = cv2.norm(
            np.ascontiguousarray(pair.render), np.ascontiguousarray(pair.truth), cv2.NORM_L2SQR, mask=mask
        )
        pixels = pair.render.shape[0] * pair.render.shape[1] if mask is None else cv2.countNonZero(mask)
        return squares / pair.data_range**2, pixels * pair.render.shape[2]
    render, truth = pair.selected(pair.render).reshape(-1), pair.selected(pair.truth).reshape(-1)
    squares = sum(_block_squares(render, truth, start, pair.data_range) for start in range(0, len(render), _BLOCK))
    if not math.isfinite(squares):
        pair.refuse_non_finite()
        raise UsageError("the squared difference is beyond float64", expected=f"pixels near {pair.data_range}")
    return squares, len(render)


def _block_squares(render: AnyArray, truth: AnyArray, start: int, data_range: float) -> float:
    block = slice(start, start + _BLOCK)
    with np.errstate(over="ignore", invalid="ignore"):
        difference = np.subtract(render[block], truth[block], dtype=np.float64)
        difference /= data_range
        # Not `@`: BLAS would start threads for a sum of this length.
        return float(np.einsum("i,i->", difference, difference))


def decibels(relative_squares: float, count: int) -> Score:
    """Return the PSNR of a sum of squared differences, as parts of the range, and of their number."""
    if count == 0:
        return EMPTY_MASK
    return Score(math.inf if relative_squares == 0 else 10.0 * math.log10(count / relative_squares))
