"""Images, and the definitions of image metrics done plainly: for tests and benchmarks."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from mirror.metrics.images.ssim_map import SsimSettings

Array = npt.NDArray[Any]

_EPSILON = 0.5 / 255
_PADS: dict[str, Any] = {"reflect": "reflect", "symmetric": "symmetric", "zero": "constant", "valid": "edge"}


def street(height: int = 90, width: int = 160, seed: int = 0) -> tuple[Array, Array]:
    """A render in other colours, with noise, and the image with texture that it is of; uint8 RGB."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    wave = 120 + 80 * np.sin(x / 17.0) * np.cos(y / 13.0)
    truth = wave[..., None] * (1.0, 0.9, 0.75) + rng.normal(0, 8, (height, width, 3))
    render = 255 * (np.clip(truth, 0, 255) / 255) ** 0.85 * (0.95, 0.9, 1.0) + rng.normal(0, 6, truth.shape)
    return _eight_bit(render), _eight_bit(truth)


def ellipse(height: int, width: int, rows: slice, columns: slice) -> Array:
    """A mask that fills a rectangle's ellipse."""
    mask = np.zeros((height, width), bool)
    y, x = np.mgrid[-1 : 1 : 1j * (rows.stop - rows.start), -1 : 1 : 1j * (columns.stop - columns.start)]
    mask[rows, columns] = y * y + x * x <= 1
    return mask


def exact_ssim(render: Array, truth: Array, how: SsimSettings, data_range: float, known: Array | None = None) -> Array:
    """Equation 13 of Wang et al. 2004 in long double, shift by shift.

    NaN where a window leaves the image and the border is ``valid``. With ``known``, windows are weighted sums over
    known pixels, divided by the sum of their weights.
    """
    radius = how.radius
    pad = ((radius, radius), (radius, radius))
    centre = np.longdouble(float(truth.min()))
    weights = np.ones(render.shape[:2], np.longdouble) if known is None else known.astype(np.longdouble)
    beyond: dict[str, Any] = {"constant_values": 1} if how.border == "zero" else {}
    weights = np.pad(weights, pad, _PADS[how.border], **beyond)[..., None]
    a, b = (
        np.where(weights > 0, np.pad(image.astype(np.longdouble), (*pad, (0, 0)), _PADS[how.border]) - centre, 0)
        for image in (render, truth)
    )
    line = np.ones(how.size, np.longdouble)
    if how.window == "gaussian":
        line = np.exp(-(np.arange(-radius, radius + 1) ** 2) / (2 * np.longdouble(how.sigma_px) ** 2))
    line /= line.sum()
    share = _windowed(weights, line)

    def mean(values: Array) -> Array:
        return _windowed(values * weights, line) / np.where(share > 0, share, np.nan)

    ma, mb = mean(a), mean(b)
    pixels = share * how.size**2
    gain = pixels / np.maximum(pixels - 1, 1) if how.sample_covariance else 1
    variances, covariance = gain * (mean(a * a + b * b) - ma * ma - mb * mb), gain * (mean(a * b) - ma * mb)
    ma, mb = ma + centre, mb + centre
    c1, c2 = (np.longdouble(how.k1) * data_range) ** 2, (np.longdouble(how.k2) * data_range) ** 2
    found = (2 * ma * mb + c1) * (2 * covariance + c2) / ((ma * ma + mb * mb + c1) * (variances + c2))
    if how.border == "valid":
        edge = np.ones(found.shape[:2], bool)
        edge[radius : edge.shape[0] - radius, radius : edge.shape[1] - radius] = False
        found[edge] = np.nan
    return np.asarray(found)


def corrected_by_lstsq(
    render: Array, truth: Array, mask: Array | None = None, iterations: int = 5
) -> tuple[Array, float, list[list[int]]]:
    """Colours, PSNR and ranks after colour correction, by numpy's singular value decomposition of all pixels' terms."""
    mask = np.ones(render.shape[:2], bool) if mask is None else mask
    colours, target = render[mask].astype(np.float64), truth[mask].astype(np.float64)
    started, ranks = colours, []
    for _ in range(iterations):
        r, g, b = colours.T
        terms = np.stack([r * r, r * g, r * b, g * g, g * b, b * b, r, g, b, np.ones(len(r))], axis=1)
        warped, found = [], []
        for channel in range(3):
            used = np.ones(len(r), bool)
            for values in (started, colours, target):
                used &= (values[:, channel] >= _EPSILON) & (values[:, channel] <= 1 - _EPSILON)
            warp, _, rank, _ = np.linalg.lstsq(terms * used[:, None], target[:, channel] * used, rcond=1e-9)
            warped.append(terms @ warp)
            found.append(int(rank))
        colours = np.clip(np.stack(warped, axis=1), 0, 1)
        ranks.append(found)
    return colours, -10 * math.log10(float(np.mean((colours - target) ** 2))), ranks


def _windowed(values: Array, line: Array) -> Array:
    """Weighted sums over windows that lie inside."""
    for axis in (0, 1):
        count = values.shape[axis] - len(line) + 1
        shifted = [np.take(values, range(k, k + count), axis) * weight for k, weight in enumerate(line)]
        values = np.sum(shifted, axis=0)
    return values


def _eight_bit(image: Array) -> Array:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def affine_by_lstsq(render: Array, truth: Array, mask: Array | None = None) -> tuple[float, list[float], list[float]]:
    """PSNR after an affine fit of each channel, its gains and offsets, by numpy's least squares; images in [0, 1]."""
    mask = np.ones(render.shape[:2], bool) if mask is None else mask
    squares, gains, offsets = [], [], []
    for x, y in zip(render[mask].astype(np.float64).T, truth[mask].astype(np.float64).T):
        used = (x >= _EPSILON) & (x <= 1 - _EPSILON) & (y >= _EPSILON) & (y <= 1 - _EPSILON)
        gain, offset = 1.0, 0.0
        if used.any():
            terms = np.stack([x[used] - x[used].mean(), np.ones(used.sum())], axis=1)
            gain, mean = np.linalg.lstsq(terms, y[used], rcond=1e-9)[0]
            gain = max(gain, 0.0)
            offset = mean - gain * x[used].mean()
        squares.append(np.mean((np.clip(gain * x + offset, 0, 1) - y) ** 2))
        gains.append(float(gain))
        offsets.append(float(offset))
    squared_error = float(np.mean(squares))
    return math.inf if squared_error == 0 else -10 * math.log10(squared_error), gains, offsets
