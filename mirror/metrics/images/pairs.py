"""A render and its photograph, checked once for every metric."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import AnyArray, Bool
from mirror.errors import UsageError
from mirror.metrics.inputs import Layout, Pixels, as_images, as_masks

ROUNDING_VARIANCE: Final = 1.0 / (12.0 * 255.0**2)
"""Variance of the rounding of values in [0, 1] to 8 bits: it keeps scores of equal and of grey images finite."""

_DTYPES: Final = ("uint8", "uint16", "float32", "float64")
_LEAST, _MOST = 1e-60, 1e60


@dataclass(frozen=True)
class ImagePair:
    """Two images that can be compared.

    Attributes:
        render: (H, W, C).
        truth: (H, W, C), of the same type.
        mask: (H, W), true where pixels count; None: all do.
        data_range: what separates black from white.
    """

    render: AnyArray
    truth: AnyArray
    mask: Bool | None
    data_range: float

    @property
    def empty(self) -> bool:
        """Return whether the mask selects no pixel."""
        return self.mask is not None and not self.mask.any()

    def selected(self, image: AnyArray) -> AnyArray:
        """Return the selected pixels (N, C) of one of the two images, row by row."""
        pixels = image.reshape(-1, image.shape[2])
        # Four times as fast as image[mask].
        return pixels if self.mask is None else np.compress(self.mask.reshape(-1), pixels, axis=0)

    def refuse_non_finite(self) -> None:
        """Raise an error if a selected pixel is NaN or infinite; the message names the first.

        Raises:
            UsageError: a pixel that counts is not finite.
        """
        if self.render.dtype.kind != "f":
            return
        for name, image in (("render", self.render), ("truth", self.truth)):
            bad = ~np.isfinite(image)
            if self.mask is not None:
                bad &= self.mask[..., None]
            if bad.any():
                row, column, channel = np.argwhere(bad)[0]
                raise UsageError(
                    f"{np.count_nonzero(bad)} values are NaN or infinite",
                    place=f"{name}, first at row {row}, column {column}, channel {channel}",
                    expected="finite pixels",
                    remedy="repair the image or leave the pixels out with a mask",
                )


def as_pairs(
    render: Pixels, truth: Pixels, mask: Pixels | None, data_range: float | None, layout: Layout | None
) -> list[ImagePair]:
    """Return the pair of an image, or the pairs of a batch, checked by `as_pair`.

    Raises:
        UsageError: neither arrays nor tensors on the CPU, another layout, or as of `as_pair`.
    """
    renders, truths = as_images(render, "render", layout), as_images(truth, "truth", layout)
    if len(renders) != len(truths):
        raise UsageError(f"{len(renders)} renders and {len(truths)} truths", expected="as many of both")
    masks = as_masks(mask, layout, len(renders))
    return [as_pair(*images, data_range) for images in zip(renders, truths, masks)]


def as_pair(render: AnyArray, truth: AnyArray, mask: AnyArray | None, data_range: float | None) -> ImagePair:
    """Check the two images and the mask of a metric, and return them as an `ImagePair`.

    Args:
        render: (H, W) or (H, W, C); uint8, uint16, float32 or float64.
        truth: of the same shape and type.
        mask: (H, W) bool, true where pixels count; None: all do.
        data_range: what separates black from white; None: 255 or 65535, by the type. Floats have no such default.

    Returns:
        The pair, with a channel axis.

    Raises:
        UsageError: shapes or types differ or are of another kind, an image has no pixels, or the range is missing or
            beyond 1e-60 to 1e60.
    """
    if render.shape != truth.shape or render.ndim not in (2, 3):
        raise UsageError(f"render {render.shape} and truth {truth.shape}", expected="one shape, (H, W) or (H, W, C)")
    if render.dtype != truth.dtype or render.dtype.name not in _DTYPES:
        raise UsageError(
            f"render of {render.dtype}, truth of {truth.dtype}", expected=f"one type of {', '.join(_DTYPES)}"
        )
    if render.size == 0:
        raise UsageError(f"images {render.shape} without a pixel", expected="at least one pixel")
    if mask is not None and (mask.dtype != np.bool_ or mask.shape != render.shape[:2]):
        raise UsageError(
            f"mask {mask.shape} of {mask.dtype}",
            expected=f"{render.shape[:2]} of bool",
            remedy="pass mask > 0 of a mask that is stored as an image",
        )
    if data_range is None:
        if render.dtype.kind == "f":
            raise UsageError(
                "data_range of float images is missing", expected="their white minus their black, 1.0 for [0, 1]"
            )
        data_range = float(np.iinfo(render.dtype).max)
    if not _LEAST <= data_range <= _MOST:
        raise UsageError(f"data_range {data_range}", expected=f"{_LEAST} to {_MOST}, whose fourth power float64 holds")
    if render.ndim == 2:
        render, truth = render[..., None], truth[..., None]
    return ImagePair(render, truth, mask, float(data_range))
