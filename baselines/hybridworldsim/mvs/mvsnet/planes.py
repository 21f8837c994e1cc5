"""Depth planes, and interpolation between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

Spacing = Literal["depth", "inverse_depth"]


@dataclass(frozen=True)
class DepthPlanes:
    """Planes from near to far, both ends included.

    Attributes:
        near_m: depth of the first plane.
        far_m: depth of the last plane.
        count: number of planes.
        spacing: the quantity in which they are evenly spaced. The published network uses depth. Inverse depth suits
            streets: each step then moves a point by about the same number of pixels.
    """

    near_m: float
    far_m: float
    count: int
    spacing: Spacing

    def depth_at(self, index: Tensor) -> Tensor:
        """Compute the depth, metres, at plane indices, which may be fractional."""
        share = index / (self.count - 1)
        if self.spacing == "depth":
            return self.near_m + share * (self.far_m - self.near_m)
        return (1.0 / self.near_m + share * (1.0 / self.far_m - 1.0 / self.near_m)).reciprocal()

    def depths_m(self) -> Tensor:
        """Return the depths (count,) of all planes, computed in float64."""
        return self.depth_at(torch.arange(self.count, dtype=torch.float64)).float()
