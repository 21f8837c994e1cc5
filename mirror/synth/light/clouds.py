"""A field of clouds that repeats, at several resolutions: how dense they are, as a quantile."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np

from mirror.arrays import Float32, Float64

SIDE: Final = 1024
"""Samples across a period of the finest level."""
LEVELS: Final = 6
PERIOD: Final = 7.0
"""Of the field, in heights of the cloud layer."""

_SEED: Final = 20
_STEEPNESS: Final = 1.95
_LONGEST: Final = 5.0
_WARP: Final = 0.016


@cache
def cloud_field() -> Float32:
    """Densities in [0, 1], evenly distributed: the share ``c`` of the sky that is above ``1 - c`` is ``c``.

    Noise with a falling spectrum, its places displaced by other such noise, which curls its edges.

    Returns:
        Read-only: the SIDE x SIDE samples of the finest level, row by row, then those of each half as fine.
    """
    rng = np.random.default_rng(_SEED)
    x, y = np.meshgrid(np.arange(SIDE, dtype=np.float64), np.arange(SIDE, dtype=np.float64))
    aside, along = (_noise(rng, _STEEPNESS + 0.4) for _ in range(2))
    field = _at(_noise(rng, _STEEPNESS), y + _WARP * SIDE * along, x + _WARP * SIDE * aside)
    # Folded noise has sharp valleys between round hills: billows.
    field = field + 0.9 * np.abs(_at(_noise(rng, _STEEPNESS - 0.15), y + 0.6 * _WARP * SIDE * aside, x))
    level = np.searchsorted(np.sort(field[::4, ::4], axis=None), field).astype(np.float64) / (SIDE // 4) ** 2
    levels = [level]
    for _ in range(LEVELS - 1):
        level = 0.25 * (level[::2, ::2] + level[1::2, ::2] + level[::2, 1::2] + level[1::2, 1::2])
        levels.append(level)
    packed = np.concatenate([one.ravel() for one in levels]).astype(np.float32)
    packed.flags.writeable = False
    return packed


def _noise(rng: np.random.Generator, steepness: float) -> Float64:
    """Periodic noise (SIDE, SIDE) of variance 1 whose amplitudes fall with the frequency to a power."""
    frequency = np.fft.fftfreq(SIDE, 1.0 / SIDE)
    size = np.hypot(frequency[: SIDE // 2 + 1], frequency[:, None])
    amplitude = np.where(size > 0.0, (size**2 + _LONGEST**2) ** (-0.5 * steepness), 0.0)
    white = np.fft.rfft2(rng.standard_normal((SIDE, SIDE)))
    noise: Float64 = np.fft.irfft2(white * amplitude, (SIDE, SIDE))
    return noise / noise.std()


def _at(values: Float64, row: Float64, column: Float64) -> Float64:
    """Bilinear values at places that wrap round."""
    i, j = np.floor(row).astype(np.int64), np.floor(column).astype(np.int64)
    u, v = column - j, row - i
    i, j = i % SIDE, j % SIDE
    below, right = (i + 1) % SIDE, (j + 1) % SIDE
    return (1 - v) * ((1 - u) * values[i, j] + u * values[i, right]) + v * (
        (1 - u) * values[below, j] + u * values[below, right]
    )
