"""A periodic field of cloud densities at several resolutions."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np

from mirror.arrays import Float32, Float64
from mirror.portable import arrays

SIDE: Final = 1024
"""Samples along a period of the finest level."""
LEVELS: Final = 6
PERIOD: Final = 7.0
"""Period of the field, in heights of the cloud layer."""

_SEED: Final = 20
_STEEPNESS: Final = 1.95
_LONGEST: Final = 5.0
_WARP: Final = 0.016


@cache
def cloud_field() -> Float32:
    """Compute densities in [0, 1] with a uniform distribution: a share ``c`` of the sky has a density above ``1 - c``.

    The field is noise with a falling spectrum, displaced by other noise, which curls the edges of the clouds.

    Returns:
        Read-only: the SIDE x SIDE samples of the finest level, row by row, then those of each coarser level.
    """
    rng = np.random.default_rng(_SEED)
    x, y = np.meshgrid(np.arange(SIDE, dtype=np.float64), np.arange(SIDE, dtype=np.float64))
    aside, along = (_noise(rng, _STEEPNESS + 0.4) for _ in range(2))
    field = _interpolate(_noise(rng, _STEEPNESS), y + _WARP * SIDE * along, x + _WARP * SIDE * aside)
    # The absolute value of noise has sharp valleys between round hills, like cumulus clouds.
    field = field + 0.9 * np.abs(_interpolate(_noise(rng, _STEEPNESS - 0.15), y + 0.6 * _WARP * SIDE * aside, x))
    level = np.searchsorted(np.sort(field[::4, ::4], axis=None), field).astype(np.float64) / (SIDE // 4) ** 2
    levels = [level]
    for _ in range(LEVELS - 1):
        level = 0.25 * (level[::2, ::2] + level[1::2, ::2] + level[::2, 1::2] + level[1::2, 1::2])
        levels.append(level)
    packed = np.concatenate([one.ravel() for one in levels]).astype(np.float32)
    packed.flags.writeable = False
    return packed


def _noise(rng: np.random.Generator, steepness: float) -> Float64:
    """Periodic noise (SIDE, SIDE) of variance 1; its amplitudes fall with a power of the frequency."""
    frequency = np.fft.fftfreq(SIDE, 1.0 / SIDE)
    size = arrays.hypot(frequency[: SIDE // 2 + 1], frequency[:, None])
    amplitude = np.where(size > 0.0, arrays.power(size**2 + _LONGEST**2, -0.5 * steepness), 0.0)
    white = np.fft.rfft2(rng.standard_normal((SIDE, SIDE)))
    noise: Float64 = np.fft.irfft2(white * amplitude, (SIDE, SIDE))
    return noise / noise.std()


def _interpolate(values: Float64, row: Float64, column: Float64) -> Float64:
    """Bilinear interpolation with periodic boundaries."""
    i, j = np.floor(row).astype(np.int64), np.floor(column).astype(np.int64)
    u, v = column - j, row - i
    i, j = i % SIDE, j % SIDE
    below, right = (i + 1) % SIDE, (j + 1) % SIDE
    return (1 - v) * ((1 - u) * values[i, j] + u * values[i, right]) + v * (
        (1 - u) * values[below, j] + u * values[below, right]
    )
