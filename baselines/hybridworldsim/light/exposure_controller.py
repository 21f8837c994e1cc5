"""A model of a camera's automatic exposure: predicts the gain from the light that the camera sees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import Tensor

from mirror.arrays import Float64

FEATURES: Final = 5
"""Numbers that describe the light of an image; see `light_features`."""

EVERY_PX: Final = 4
"""Every fourth pixel of every fourth row shows how much light there is."""

_DARKEST: Final = 1e-4
_LUMINANCE: Final = (0.2126, 0.7152, 0.0722)
_RIDGE: Final = 1e-3
_LEAST_IMAGES: Final = 2 * (FEATURES + 1)
_TUKEY: Final = 4.685
_REWEIGHTED: Final = 20
_BEYOND: Final = 0.2
"""A prediction may leave the range of the training gains by this much, in logarithms."""


def light_features(light: Tensor) -> Float64:
    """Describe the light of an image at gain one, as exposure meters see it.

    Args:
        light: (H, W, 3) light of every `EVERY_PX`-th pixel, or of all.

    Returns:
        (5,) logarithms of the geometric mean, of the mean in the middle ninth, and of the 5, 75 and 95 % quantiles of
        the luminance.
    """
    seen = light.detach() @ light.new_tensor(_LUMINANCE)
    logs = seen.double().clamp_min(_DARKEST).log()
    rows, columns = logs.shape
    middle = logs[rows // 3 : rows - rows // 3, columns // 3 : columns - columns // 3]
    quantiles = torch.quantile(logs.flatten(), logs.new_tensor([0.05, 0.75, 0.95]))
    features: Float64 = torch.cat([logs.mean()[None], middle.mean()[None], quantiles]).cpu().numpy()
    return features


@dataclass(frozen=True, eq=False)
class ExposureController:
    """The law of exposure of one camera in one light.

    Attributes:
        coefficients: (6,) of one and of the features less their means, in the unit of the logarithm of the gain.
        means: (5,) means of the features of training images.
        low: smallest logarithm of a gain.
        high: largest logarithm of a gain.
    """

    coefficients: Float64
    means: Float64
    low: float
    high: float

    def log_gain(self, features: Float64) -> float:
        """Return the logarithm of the gain of an image with these features (5,)."""
        value = float(self.coefficients[0] + self.coefficients[1:] @ (features - self.means))
        return min(max(value, self.low), self.high)

    def numbers(self) -> list[float]:
        """Return the law as 13 numbers, see `controller_from`."""
        return [*self.coefficients.tolist(), *self.means.tolist(), self.low, self.high]


def controller_from(numbers: Sequence[float]) -> ExposureController:
    """Return the law of `ExposureController.numbers`."""
    values = np.asarray(numbers, np.float64)
    return ExposureController(values[: FEATURES + 1], values[FEATURES + 1 : -2], float(values[-2]), float(values[-1]))


def fit_controller(features: Float64, log_gains: Float64) -> ExposureController:
    """Fit the law of exposure to training images, robustly: by reweighted least squares with Tukey's weights.

    Args:
        features: (N, 5) of the images at gain one.
        log_gains: (N,) logarithms of their gains.

    Returns:
        The law. With fewer than twelve images the gain is their median: the law would not be determined.
    """
    middle = float(np.median(log_gains)) if len(log_gains) else 0.0
    means: Float64 = features.mean(axis=0) if len(features) else np.zeros(FEATURES)
    coefficients: Float64 = np.zeros(FEATURES + 1)
    coefficients[0] = middle
    if len(log_gains) < _LEAST_IMAGES:
        return ExposureController(coefficients, means, middle, middle)
    inputs = np.column_stack([np.ones(len(features)), features - means])
    penalty = _RIDGE * len(features) * np.diag([0.0, *[1.0] * FEATURES])
    weights = np.ones(len(features))
    for _ in range(_REWEIGHTED):
        weighted = inputs * weights[:, None]
        coefficients = np.asarray(np.linalg.solve(weighted.T @ inputs + penalty, weighted.T @ log_gains), np.float64)
        residuals = np.abs(log_gains - inputs @ coefficients)
        scale = max(1.4826 * float(np.median(residuals)), 1e-6)
        weights = np.square(np.maximum(1.0 - np.square(residuals / (_TUKEY * scale)), 0.0))
    low, high = float(log_gains.min()) - _BEYOND, float(log_gains.max()) + _BEYOND
    return ExposureController(coefficients, means, low, high)


def fit_controllers(seen: Mapping[str, tuple[str, Float64, float]]) -> dict[str, ExposureController]:
    """Fit one law to each group of images.

    Args:
        seen: by name of an image: its group, its features (5,), and the logarithm of its gain.
    """
    groups: dict[str, list[tuple[Float64, float]]] = {}
    for group, features, log_gain in seen.values():
        groups.setdefault(group, []).append((features, log_gain))
    return {
        group: fit_controller(np.array([one for one, _ in rows]), np.array([gain for _, gain in rows]))
        for group, rows in groups.items()
    }
