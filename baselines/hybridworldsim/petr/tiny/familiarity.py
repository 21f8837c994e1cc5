"""A test of whether images look like those that a network was trained on, by their local statistics.

Statistics of an image in the network's size: how fast its spectrum falls, quantiles and kurtosis of the gradients of
its logarithmic luminance, contrast of small blocks, gradients above, in and below the middle, the strength of colour
and of its gradients, the range of luminance, and the shares of clipped and of black pixels. An image is unfamiliar if
the Mahalanobis distance of its statistics from those of the training images is above a limit that few training images
exceed. The test learns from training images alone; it says nothing about the accuracy of boxes.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Final, Literal

import cv2
import numpy as np

from mirror.arrays import Bool, Float64, UInt8
from mirror.errors import UsageError
from mirror.schema.documents import Document
from mirror.schema.files import read_json, write_json

NAME: Final = "inputs.json"
_BANDS: Final = (0.12, 0.2, 0.3, 0.4, 0.5)
_QUANTILES: Final = (0.5, 0.75, 0.9, 0.98)
_CONTRASTS: Final = (0.1, 0.3, 0.5, 0.7, 0.9)
_BLOCK_PX: Final = 4
_QUALITIES: Final = (95, 80)
"""JPEG qualities in which training images are seen again, because other datasets have other ones."""
_LIMIT: Final = 0.98
"""Share of the training images within the limit."""
STATISTICS: Final = (
    *(f"fall of the spectrum from {low:g} cycles a pixel" for low in _BANDS[1:-1]),
    *(f"gradient, quantile {quantile:g}" for quantile in _QUANTILES),
    "kurtosis of horizontal gradients", "kurtosis of vertical gradients",
    "red-green gradients to luminance", "blue-yellow gradients to luminance",
    "chroma, median", "chroma, quantile 0.9", "clipped pixels", "black pixels",
    *(f"contrast of blocks, quantile {quantile:g}" for quantile in _CONTRASTS),
    *(f"gradients of the {third} third" for third in ("upper", "middle", "lower")), "range of luminance",
)  # fmt: skip
_FLOOR: Final = (0.3, 0.02)
"""Standard deviation that is added to each statistic, as a share of its own and in its unit: a statistic that varies
little between training images must not decide alone."""


class FamiliarInputs(Document):
    """``inputs.json`` beside a model: the distribution of the statistics of its training images.

    Attributes:
        format: always ``mirror-petr-tiny-inputs``.
        version: version of this document.
        model_sha256: hash of the model's file.
        trained_on: what the images show, in a few words.
        images: number of training images.
        statistics: names of the K statistics.
        mean: their K means.
        covariance: their covariance, K rows.
        limit: greatest Mahalanobis distance of a familiar image.
    """

    format: Literal["mirror-petr-tiny-inputs"] = "mirror-petr-tiny-inputs"
    version: Literal["1"] = "1"
    model_sha256: str
    trained_on: str
    images: int
    statistics: tuple[str, ...]
    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    limit: float

    def distances(self, images: UInt8) -> Float64:
        """Return the Mahalanobis distances (N,) of RGB images (N, H, W, 3) in the network's size."""
        return _distances(image_statistics(images), np.array(self.mean), np.array(self.covariance))

    def are_unfamiliar(self, images: UInt8) -> Bool:
        """Mark which of N images do not look like the training images."""
        return np.asarray(self.distances(images) > self.limit, np.bool_)


def image_statistics(images: UInt8) -> Float64:
    """Return the statistics (N, K) of RGB images (N, H, W, 3), in the order of `STATISTICS`."""
    return np.stack([_statistics(image) for image in images])


def fit_inputs(images: UInt8, model_sha256: str, trained_on: str) -> FamiliarInputs:
    """Learn the distribution of training images (N, H, W, 3), both original and after JPEG compression."""
    again = [_compress(image, quality) for quality in _QUALITIES for image in images]
    values = image_statistics(np.concatenate([images, np.stack(again)]))
    share, least = _FLOOR
    mean, floor = values.mean(axis=0), share * values.std(axis=0) + least
    covariance = np.cov(values.T) + np.diag(floor**2)
    limit = float(np.quantile(_distances(values, mean, covariance), _LIMIT))
    return FamiliarInputs(
        model_sha256=model_sha256, trained_on=trained_on, images=len(images), statistics=STATISTICS,
        mean=tuple(mean.tolist()), covariance=tuple(map(tuple, covariance.tolist())), limit=limit,
    )  # fmt: skip


def write_inputs(path: Path, inputs: FamiliarInputs) -> None:
    """Write the document of a model."""
    write_json(path, inputs)


def read_inputs(path: Path, model_sha256: str) -> FamiliarInputs | None:
    """Read the document of a model; None if it has no document.

    Raises:
        UsageError: the document belongs to another model, or to other statistics.
        SchemaError: it is broken.
    """
    if not path.is_file():
        return None
    inputs = read_json(path, FamiliarInputs)
    if inputs.model_sha256 != model_sha256 or inputs.statistics != STATISTICS:
        raise UsageError(
            f"belongs to the model {inputs.model_sha256[:8]} and {len(inputs.statistics)} statistics", file=path,
            expected=f"the file of the model {model_sha256[:8]}",
            remedy="copy the model together with the files beside it, or remove this file",
        )  # fmt: skip
    return inputs


def _distances(values: Float64, mean: Float64, covariance: Float64) -> Float64:
    away = values - mean
    return np.asarray(np.sqrt((away * np.linalg.solve(covariance, away.T).T).sum(axis=1)), np.float64)


def _compress(image: UInt8, quality: int) -> UInt8:
    encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), np.uint8)


def _statistics(image: UInt8) -> Float64:
    # Channels apart, as contiguous arrays: half the time of strided ones.
    channels = np.ascontiguousarray(np.moveaxis(image, -1, 0)) / 255.0
    red, green, blue = channels
    luminance = 0.299 * red + 0.587 * green + 0.114 * blue
    red_green = red - green
    blue_yellow = 0.5 * (red + green) - blue
    light = np.log(luminance + 0.02)
    across, down = np.diff(light, axis=1)[:-1], np.diff(light, axis=0)[:, :-1]
    gradients = np.quantile(np.hypot(across, down), _QUANTILES)
    # Products: a fourth power takes numpy ten times as long.
    kurtosis = [np.mean(np.square(one)) / max(np.mean(one) ** 2, 1e-12) + 1e-3 for one in (across**2, down**2)]
    grey = np.abs(np.diff(luminance, axis=1)).mean() + 1e-4
    colour = [(np.abs(np.diff(one, axis=1)).mean() + 1e-4) / grey for one in (red_green, blue_yellow)]
    chroma = np.quantile(np.hypot(red_green, blue_yellow), (0.5, 0.9)) + 2e-3
    brightest = channels.max(axis=0)
    extremes = np.sqrt([(brightest > 0.98).mean(), (brightest < 0.04).mean()])
    thirds = [np.abs(np.diff(part, axis=1)).mean() + 1e-3 for part in np.array_split(light, 3)]
    low, high = np.quantile(luminance, (0.02, 0.98))
    return np.concatenate(
        [_falls(light), np.log(gradients + 1e-3), np.log(kurtosis), np.log(colour), np.log(chroma), extremes,
         np.log(_contrasts(light) + 2e-3), np.log(thirds), [high - low]]
    )  # fmt: skip


def _contrasts(light: Float64) -> Float64:
    """Quantiles of the standard deviation in small blocks."""
    rows, columns = (length // _BLOCK_PX for length in light.shape)
    blocks = light[: rows * _BLOCK_PX, : columns * _BLOCK_PX].reshape(rows, _BLOCK_PX, columns, _BLOCK_PX)
    return np.asarray(np.quantile(blocks.std(axis=(1, 3)), _CONTRASTS), np.float64)


def _falls(light: Float64) -> Float64:
    """Differences of the logarithmic power in neighbouring bands of spatial frequency."""
    height, width = light.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    power = np.abs(np.fft.fft2((light - light.mean()) * window)) ** 2
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width)[None])
    levels = [np.log(power[(frequency >= low) & (frequency < high)].mean() + 1e-9) for low, high in pairwise(_BANDS)]
    return np.asarray(np.diff(levels), np.float64)
