"""The map of structural similarity: four separable filters on centred pixels.

With ``d = render - truth``, windowed means ``m`` and variances ``v``,

    SSIM = (1 - m_d² / (m_r² + m_t² + C1)) (1 - v_d / (v_r + v_t + C2)),

which is Wang et al. 2004, equation 13, without its cancellations: equal windows give exactly 1, and nothing exceeds 1.
Pixels are centred before they are squared, so that an offset costs no digits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Literal, TypeAlias

import cv2
import numpy as np

from mirror.arrays import AnyArray, Bool, Float64
from mirror.errors import UsageError
from mirror.metrics.images.ssim_kernels import similarity

Border: TypeAlias = Literal["valid", "reflect", "symmetric", "zero"]
Precision: TypeAlias = Literal["float64", "float32"]

_BORDERS: Final = {
    "reflect": cv2.BORDER_REFLECT_101,
    "symmetric": cv2.BORDER_REFLECT,
    "zero": cv2.BORDER_CONSTANT,
    "valid": cv2.BORDER_REFLECT_101,
}
_TILE_ROWS: Final = 64


@dataclass(frozen=True)
class SsimSettings:
    """The settings that distinguish variants of SSIM.

    Attributes:
        window: shape of the window's weights.
        size: its width and height in pixels, odd.
        sigma_px: of the gaussian; without meaning for a uniform window.
        border: ``valid``: only windows inside the image; ``reflect``: mirrored without the edge pixel;
            ``symmetric``: with it; ``zero``: black beyond the image.
        sample_covariance: whether variances are divided by N - 1.
        k1: C1 is (k1 data_range)².
        k2: C2 is (k2 data_range)².
    """

    window: Literal["gaussian", "uniform"]
    size: int
    sigma_px: float
    border: Border
    sample_covariance: bool = False
    k1: float = 0.01
    k2: float = 0.03

    def __post_init__(self) -> None:
        if self.window not in ("gaussian", "uniform") or self.border not in _BORDERS:
            raise UsageError(f"window {self.window!r}, border {self.border!r}", expected=f"one of {list(_BORDERS)}")
        if self.size < 1 or self.size % 2 == 0 or not self.sigma_px > 0 or (self.sample_covariance and self.size == 1):
            raise UsageError(f"window of {self.size} px, sigma {self.sigma_px} px", expected="an odd size, sigma > 0")
        if self.sample_covariance and self.window != "uniform":
            raise UsageError("sample covariance under a gaussian window", expected="a uniform window")

    @property
    def radius(self) -> int:
        """The window's reach in pixels."""
        return self.size // 2


def map_tiles(
    render: AnyArray,
    truth: AnyArray,
    known: Bool | None,
    rows: slice,
    columns: slice,
    settings: SsimSettings,
    precision: Precision,
    data_range: float,
) -> Iterator[AnyArray]:
    """Yield the SSIM map 64 rows at a time, to avoid arrays as large as the image.

    Args:
        render: (H, W, C) whole image.
        truth: (H, W, C) whole image.
        known: (H, W) pixels that take part in windows; None: all.
        rows: which part.
        columns: which part.
        settings: the window, its border and the constants.
        precision: type of the map.
        data_range: what separates black from white.

    Yields:
        (64 or fewer, w, C); all NaN if a pixel that takes part, in the rectangle that windows reach, is not finite.

    Raises:
        UsageError: the range is out of the precision's reach.
    """
    if precision == "float32" and not 1e-6 <= data_range <= 1e6:
        raise UsageError(f"data_range {data_range} in float32", expected="1e-6 to 1e6", remedy="take float64")
    across, sides = _reach(columns, settings.radius, render.shape[1])
    whole = (_reach(rows, settings.radius, render.shape[0])[0], across)
    centre = _centre(render[whole], truth[whole], None if known is None else known[whole])
    constants = ((settings.k1 * data_range) ** 2, (settings.k2 * data_range) ** 2)
    dtype = np.dtype(precision)
    for start in range(rows.start, rows.stop, _TILE_ROWS):
        tile = slice(start, min(start + _TILE_ROWS, rows.stop))
        along, ends = _reach(tile, settings.radius, render.shape[0])
        inside, pad = (along, across), (ends, sides)
        images = [_pad(np.ascontiguousarray(image[inside]), pad, settings.border, 0.0) for image in (render, truth)]
        weights = None if known is None else _pad(known[inside].astype(dtype), pad, settings.border, 1.0)
        yield _tile(images[0], images[1], weights, centre, settings, constants, dtype)


def _tile(
    render: AnyArray,
    truth: AnyArray,
    known: AnyArray | None,
    centre: float,
    settings: SsimSettings,
    constants: tuple[float, float],
    dtype: np.dtype[Any],
) -> AnyArray:
    height, width, channels = render.shape
    reach, kind = 2 * settings.radius, dtype.type
    found = np.empty((height - reach, width - reach, channels), kind)
    similarity(
        render.reshape(height, -1),
        truth.reshape(height, -1),
        None if known is None else np.repeat(known, channels, axis=1),
        channels,
        np.result_type(render.dtype, dtype).type(centre),
        _taps(settings.window, settings.size, settings.sigma_px).astype(kind),
        kind(constants[0]),
        kind(constants[1]),
        settings.sample_covariance,
        found.reshape(len(found), -1),
    )
    return found


@lru_cache
def _taps(window: str, size: int, sigma_px: float) -> Float64:
    if window == "uniform":
        return np.full(size, 1.0 / size)
    taps = np.exp(-0.5 * (np.arange(size) - size // 2) ** 2 / sigma_px**2)
    return taps / taps.sum()


def _reach(part: slice, radius: int, length: int) -> tuple[slice, tuple[int, int]]:
    """Return the pixels that windows on a part of an axis reach, and how far they reach beyond the image."""
    first, last = part.start - radius, part.stop + radius
    return slice(max(first, 0), min(last, length)), (max(-first, 0), max(last - length, 0))


def _centre(render: AnyArray, truth: AnyArray, known: Bool | None) -> float:
    """The middle of the values."""
    if known is not None:
        render, truth = render[known], truth[known]
    if render.size == 0:
        return 0.0
    low, high = float(np.minimum(render.min(), truth.min())), float(np.maximum(render.max(), truth.max()))
    return low + 0.5 * (high - low)


def _pad(image: AnyArray, pad: tuple[tuple[int, int], ...], border: Border, beyond: float) -> AnyArray:
    (top, bottom), (left, right) = pad
    if not (top or bottom or left or right):
        return image
    padded = cv2.copyMakeBorder(image, top, bottom, left, right, _BORDERS[border], value=beyond)
    return padded.reshape(padded.shape[:2] + image.shape[2:])
