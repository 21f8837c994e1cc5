"""The noise of images as a function of their values: measured in recordings, added to renderings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float32, Float64, UInt8

_BINS: Final = 16
_LEAST_PIXELS: Final = 200
_ROUNDING: Final = 1.0 / 12.0
"""Variance that rounding to eight bits adds, in squares of a level."""
_LEVELS: Final = 255.0
_LAPLACIAN: Final = 36.0
"""Variance of a 3 x 3 window with the weights 1 -2 1, -2 4 -2, 1 -2 1 (J. Immerkaer, 1996) on noise of variance one."""


@dataclass(frozen=True)
class SensorNoise:
    """Noise whose standard deviation depends on the value of the image, not on its neighbours.

    Attributes:
        deviations: standard deviation at 17 evenly spaced values of the image, from 0 to 1.
    """

    deviations: tuple[float, ...]

    def scaled(self, factor: float) -> SensorNoise:
        """Return the noise of a raster that is wider by a factor: an average of fewer pixels has more noise."""
        return SensorNoise(tuple(factor * deviation for deviation in self.deviations))

    def add(self, rgb: Float32, seed: int) -> UInt8:
        """Return an image with noise.

        Args:
            rgb: (H, W, 3) values, 0 to 1.
            seed: seed of the noise; equal seeds give equal noise.
        """
        values = np.clip(rgb.astype(np.float32), 0.0, 1.0)
        spread = np.interp(values, np.linspace(0.0, 1.0, len(self.deviations)), self.deviations)
        noise = np.random.default_rng(seed).standard_normal(values.shape, np.float32)
        noisy: UInt8 = (np.clip(values + spread * noise, 0.0, 1.0) * _LEVELS + 0.5).astype(np.uint8)
        return noisy


class NoiseSamples:
    """Collects the noise of recorded images by their values: 17 numbers an image.

    Args:
        table: (N, 17) samples of earlier images, as `table` returns them.
    """

    def __init__(self, table: Float64 | None = None) -> None:
        self._medians: list[Float64] = [] if table is None else list(table)

    def __len__(self) -> int:
        return len(self._medians)

    def table(self) -> Float64:
        """Return the samples (N, 17): a row for each image, with one median for each value; NaN: too few pixels."""
        return np.array(self._medians).reshape(-1, _BINS + 1)

    def add(self, image: Float32, scored: Bool) -> None:
        """Add an image.

        The noise of a place is what a filter leaves of it that removes constant, linear and saddle-shaped parts. The
        median of the magnitudes, taken in each bin, ignores edges and texture of less than half of the places.

        Args:
            image: (H, W, 3) values, 0 to 1.
            scored: (H, W) pixels of the street.
        """
        if min(image.shape[:2]) < 3:
            self._medians.append(np.full(_BINS + 1, np.nan))
            return
        rows: Float64 = image.astype(np.float64)
        second = rows[:, :-2] - 2.0 * rows[:, 1:-1] + rows[:, 2:]
        filtered = np.abs(second[:-2] - 2.0 * second[1:-1] + second[2:])
        inside = scored[:-2, :-2] & scored[2:, 2:] & scored[:-2, 2:] & scored[2:, :-2] & scored[1:-1, 1:-1]
        means = (rows[:-2, 1:-1] + rows[2:, 1:-1] + rows[1:-1, :-2] + rows[1:-1, 2:] + rows[1:-1, 1:-1]) / 5.0
        bins = np.minimum((means[inside] * _BINS + 0.5).astype(np.int64), _BINS)
        magnitudes = filtered[inside]
        medians = np.full(_BINS + 1, np.nan)
        for level in range(_BINS + 1):
            own = magnitudes[bins == level]
            if len(own) >= _LEAST_PIXELS:
                medians[level] = np.median(own)
        self._medians.append(medians)

    def fit(self) -> SensorNoise | None:
        """Return the noise; None if no image had enough pixels of a value.

        For each value it is the lower quartile over images: texture adds to what is measured, and nothing subtracts.
        """
        if not self._medians:
            return None
        table = np.array(self._medians)
        known = ~np.isnan(table).all(axis=0)
        if not known.any():
            return None
        quartiles = np.nanquantile(table[:, known], 0.25, axis=0)
        # The median of |x| of a normal distribution is 0.6745 of its standard deviation.
        deviations = quartiles / 0.674490 / np.sqrt(_LAPLACIAN)
        variances = np.maximum(np.square(deviations) - _ROUNDING / _LEVELS**2, 0.0)
        levels = np.linspace(0.0, 1.0, _BINS + 1)
        filled = np.interp(levels, levels[known], np.sqrt(variances))
        return SensorNoise(tuple(filled.tolist()))
