"""The monotone curve by which a camera turns light into image values."""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

PIVOT: Final = 0.18
"""Light that every curve maps to itself: without it a gain and a curve could not be distinguished."""
DARKEST: Final = 2.0**-12
"""Smaller light and smaller image values count as this."""

_FIRST_STOP: Final = -9
_LAST_STOP: Final = 6
_SLOPE: Final = 1.0 / 2.2
"""Slope before training: that of usual images, so that a gain is about one of light."""
_SHOULDER_STOP: Final = 2
_SHOULDER_SLOPE: Final = 0.1
"""Slope before training from this stop on, so that what is white stays nearly white at a smaller gain."""
_LEAST_SLOPE: Final = 0.02


class ToneCurve(nn.Module):
    """A strictly increasing curve f for each camera, with f(0.18) = 0.18.

    In logarithms of base two a curve is piecewise linear, with one slope for each stop of light between 2**-9 and 2**6;
    beyond these the first and the last slope continue. It has an exact inverse.

    Args:
        count: number of curves.
    """

    def __init__(self, count: int) -> None:
        super().__init__()
        stops = range(_FIRST_STOP, _LAST_STOP)
        slopes = [_SLOPE if stop < _SHOULDER_STOP else _SHOULDER_SLOPE for stop in stops]
        start = torch.tensor([math.log(math.expm1(slope - _LEAST_SLOPE)) for slope in slopes])
        self.slopes = nn.Parameter(start.repeat(count, 1))

    def forward(self, light: Tensor, curve: int) -> Tensor:
        """Return the image values of light, of any shape; both are 0 or more."""
        stops, levels, slopes = self.knots(curve)
        return _interpolate(light.clamp_min(DARKEST).log2(), stops, levels, slopes).exp2()

    def invert(self, values: Tensor, curve: int) -> Tensor:
        """Return the light of image values, of any shape; both are 0 or more."""
        stops, levels, slopes = self.knots(curve)
        return _interpolate(values.clamp_min(DARKEST).log2(), levels, stops, 1.0 / slopes).exp2()

    def knots(self, curve: int) -> tuple[Tensor, Tensor, Tensor]:
        """Return the logarithms of light and of image values (K + 1,) at the knots, and the slopes (K,) between."""
        slopes = functional.softplus(self.slopes[curve]) + _LEAST_SLOPE
        stops = torch.arange(_FIRST_STOP, _LAST_STOP + 1, dtype=slopes.dtype, device=slopes.device)
        levels = torch.cat([slopes.new_zeros(1), slopes.cumsum(0)])
        pivot = slopes.new_tensor([math.log2(PIVOT)])
        return stops, levels - _interpolate(pivot, stops, levels, slopes) + pivot, slopes


def _interpolate(x: Tensor, knots: Tensor, values: Tensor, slopes: Tensor) -> Tensor:
    """Interpolate linearly between knots, and continue with the first and the last slope."""
    segment = torch.bucketize(x.detach(), knots.detach()[1:-1])
    return values[segment] + slopes[segment] * (x - knots[segment])
