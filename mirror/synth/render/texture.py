"""Procedural textures, filtered in closed form over a pixel's footprint, so that distant surfaces do not flicker."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mirror.compiled import inner_per_pixel, per_pixel

_MASK: Final = 127
_RANDOM: Final = np.random.default_rng(0).uniform(-1.0, 1.0, (_MASK + 1, _MASK + 1)).astype(np.float32)


@inner_per_pixel()
def hash_unit(i: int, j: int, seed: int) -> float:
    """Hash three integers to a number in [0, 1) (a xor-shift multiply hash)."""
    h = np.uint64(i * 0x9E3779B1 + j * 0x85EBCA77 + seed * 0xC2B2AE3D)
    h = (h ^ (h >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(32))) * np.uint64(0x94D049BB133111EB)
    return float(h >> np.uint64(40)) / 16777216.0


@inner_per_pixel()
def noise(x: float, y: float, seed: int) -> float:
    """Return smooth noise in [-1, 1] with a grain size of 1 and a period of 128."""
    i, j = math.floor(x), math.floor(y)
    u, v = x - i, y - j
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    row, column = (int(j) + 37 * seed) & _MASK, (int(i) + 59 * seed) & _MASK
    below, right = (row + 1) & _MASK, (column + 1) & _MASK
    a = _RANDOM[row, column] * (1.0 - u) + _RANDOM[row, right] * u
    b = _RANDOM[below, column] * (1.0 - u) + _RANDOM[below, right] * u
    return a * (1.0 - v) + b * v


@inner_per_pixel()
def grain(x: float, y: float, size: float, footprint: float, seed: int) -> float:
    """Return the noise with a grain size; it fades out where the footprint is wider than the grain."""
    visible = 1.5 - footprint / size
    if visible <= 0.0:
        return 0.0
    return min(visible, 1.0) * noise(x / size, y / size, seed)


@inner_per_pixel()
def band(x: float, low: float, high: float, footprint: float) -> float:
    """Return the share of the footprint around x that is within [low, high]."""
    width = max(footprint, 1e-6)
    covered = min(high, x + 0.5 * width) - max(low, x - 0.5 * width)
    return min(max(covered / width, 0.0), 1.0)


@inner_per_pixel()
def _stripes_before(x: float, duty: float) -> float:
    periods = math.floor(x)
    return periods * duty + min(x - periods, duty)


@per_pixel()
def stripes(x: float, period: float, duty: float, footprint: float) -> float:
    """Return the share of the footprint around x that is on stripes, which fill the first ``duty`` of every period."""
    x, width = x / period, max(footprint / period, 1e-6)
    return (_stripes_before(x + 0.5 * width, duty) - _stripes_before(x - 0.5 * width, duty)) / width
