"""The tone curve from exposed light to 8-bit levels: sRGB with a toe and a shoulder."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np

from mirror.arrays import Float64, UInt8
from mirror.portable import arrays

BRIGHTEST: Final = 16.0
"""Exposed light above this is white."""
STEPS: Final = 1 << 14

_TOE: Final = 0.022
_SHOULDER: Final = 0.62


def film(exposed: Float64) -> Float64:
    """Map exposed light to levels in [0, 1), where white in a correctly exposed image has light 1.

    The curve is the sRGB encoding with darker shadows, and with a shoulder that compresses highlights.

    Args:
        exposed: (...,) exposed light; negative values count as 0.
    """
    light = np.maximum(exposed, 0.0)
    coded = np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * arrays.power(np.maximum(light, 1e-12), 1.0 / 2.4) - 0.055
    )
    toed = coded * coded * (1.0 + _TOE) / (coded + _TOE)
    rest = 1.0 - _SHOULDER
    compressed = _SHOULDER + rest * (1.0 - arrays.exp(-(toed - _SHOULDER) / rest))
    return np.where(toed < _SHOULDER, toed, compressed)


@cache
def film_table() -> UInt8:
    """Return read-only 8-bit levels (STEPS,) at evenly spaced square roots of light, from 0 to BRIGHTEST's.

    Between two steps the level changes by less than 0.03, so the nearest step is accurate to half a level.
    """
    root = np.linspace(0.0, np.sqrt(BRIGHTEST), STEPS)
    table = np.floor(255.0 * film(root**2) + 0.5).astype(np.uint8)
    table.flags.writeable = False
    return table


@cache
def gaussian_table() -> Float64:
    """Return 4096 quantiles of a normal distribution of variance 1, equally probable; read-only."""
    from statistics import NormalDist

    normal = NormalDist()
    values = np.array([normal.inv_cdf((step + 0.5) / 4096) for step in range(4096)])
    values /= values.std()
    values.flags.writeable = False
    return values
