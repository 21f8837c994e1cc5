"""The map of structural similarity: four separable filters a tile, on centred pixels.

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
    """What tells one SSIM from another.

    Attributes:
        window: shape of the window's weights.
        size: its width and height in pixels, odd.
        sigma_px: of the gaussian; without meaning for a uniform window.
        border: ``valid``: only windows inside the picture; ``reflect``: mirrored without the edge pixel;
            ``symmetric``: with it; ``zero``: black beyond the picture.
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
        """How far the window reaches, in pixels."""
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
    """Part of the map, 64 rows at a time, so that what belongs to a tile stays in the processor's cache.

    Args:
        render: (H, W, C) whole picture.
        truth: (H, W, C) whole picture.
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
    if precision == "float32" and not 1e-12 <= data_range <= 1e12:
        raise UsageError(f"data_range {data_range} in float32", expected="1e-12 to 1e12", remedy="take float64")
    across, sides = _reach(columns, settings.radius, render.shape[1])
    whole = (_reach(rows, settings.radius, render.shape[0])[0], across)
    centre = _centre(render[whole], truth[whole], None if known is None else known[whole])
    constants = ((settings.k1 * data_range) ** 2, (settings.k2 * data_range) ** 2)
    dtype = np.dtype(precision)
    for start in range(rows.start, rows.stop, _TILE_ROWS):
        tile = slice(start, min(start + _TILE_ROWS, rows.stop))
        along, ends = _reach(tile, settings.radius, render.shape[0])
        inside, pad = (along, across), (ends, sides)
        taking_part = None if known is None else known[inside]
        with np.errstate(invalid="ignore", over="ignore"):
            shifted = [
                _pad(_shift(picture[inside], centre, taking_part, dtype), pad, settings.border, -centre)
                for picture in (render, truth)
            ]
            weights = None if taking_part is None else _pad(taking_part.astype(dtype), pad, settings.border, 1.0)
            found = _tile(shifted[0], shifted[1], weights, centre, settings, constants)
        yield found


def _tile(
    render: AnyArray,
    truth: AnyArray,
    known: AnyArray | None,
    centre: float,
    settings: SsimSettings,
    constants: tuple[float, float],
) -> AnyArray:
    c1, c2 = constants
    pixels: Any = settings.size**2
    difference = render - truth
    powers = render * render
    powers += truth * truth
    mean, mean_difference = _filter(render, settings), _filter(difference, settings)
    power, power_difference = _filter(powers, settings), _filter(np.multiply(difference, difference), settings)
    if known is not None:
        share = np.maximum(_filter(known[..., None], settings), np.finfo(known.dtype).tiny)
        for filtered in (mean, mean_difference, power, power_difference):
            filtered /= share
        pixels = pixels * share
    # From here on in place: power becomes the variances' sum, power_difference the structure term.
    mean_truth = mean - mean_difference
    mean_difference *= mean_difference
    power -= mean * mean
    power -= mean_truth * mean_truth
    np.maximum(power, 0.0, out=power)
    power_difference -= mean_difference
    np.maximum(power_difference, 0.0, out=power_difference)
    if settings.sample_covariance:
        gain = pixels / np.maximum(pixels - 1.0, 1.0)
        power *= gain
        power_difference *= gain
    power += c2
    power_difference /= power
    np.subtract(1.0, power_difference, out=power_difference)
    mean += centre
    mean *= mean
    mean_truth += centre
    mean_truth *= mean_truth
    mean += mean_truth
    mean += c1
    mean_difference /= mean
    np.subtract(1.0, mean_difference, out=mean_difference)
    mean_difference *= power_difference
    return mean_difference


def _filter(picture: AnyArray, settings: SsimSettings) -> AnyArray:
    """Windowed mean at every pixel that has its whole window."""
    kernel, radius = _kernel(settings.window, settings.size, settings.sigma_px), settings.radius
    depth = cv2.CV_64F if picture.dtype == np.float64 else cv2.CV_32F
    filtered = cv2.sepFilter2D(picture, depth, kernel, kernel, borderType=cv2.BORDER_REPLICATE)
    rows, columns = picture.shape[:2]
    return filtered.reshape(picture.shape)[radius : rows - radius, radius : columns - radius]


@lru_cache
def _kernel(window: str, size: int, sigma_px: float) -> Float64:
    if window == "uniform":
        return np.full(size, 1.0 / size)
    kernel = np.exp(-0.5 * (np.arange(size) - size // 2) ** 2 / sigma_px**2)
    return kernel / kernel.sum()


def _reach(part: slice, radius: int, length: int) -> tuple[slice, tuple[int, int]]:
    """What windows on a part of an axis reach, and by how much they reach beyond the picture."""
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


def _shift(picture: AnyArray, centre: float, known: Bool | None, dtype: np.dtype[Any]) -> AnyArray:
    shifted = picture.astype(np.result_type(picture.dtype, dtype))
    shifted -= centre
    if known is not None:
        shifted[~known] = 0.0
    return shifted.astype(dtype, copy=False)


def _pad(picture: AnyArray, pad: tuple[tuple[int, int], ...], border: Border, beyond: float) -> AnyArray:
    (top, bottom), (left, right) = pad
    if not (top or bottom or left or right):
        return picture
    channels = 1 if picture.ndim == 2 else picture.shape[2]
    padded = cv2.copyMakeBorder(picture, top, bottom, left, right, _BORDERS[border], value=[beyond] * channels)
    return padded.reshape(padded.shape[:2] + picture.shape[2:])
