"""Planes of depth, and depth between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

Spacing = Literal["depth", "inverse_depth"]


@dataclass(frozen=True)
class DepthPlanes:
    """Planes from near to far, the ends included.

    Attributes:
        near_m: depth of the first.
        far_m: depth of the last.
        count: how many.
        spacing: what they are even in: depth, as published, or inverse depth, where each step moves a point by about
            as many pixels, as streets need.
    """

    near_m: float
    far_m: float
    count: int
    spacing: Spacing

    def depth_m(self, index: Tensor) -> Tensor:
        """Depth at indices, whole or not."""
        share = index / (self.count - 1)
        if self.spacing == "depth":
            return self.near_m + share * (self.far_m - self.near_m)
        return (1.0 / self.near_m + share * (1.0 / self.far_m - 1.0 / self.near_m)).reciprocal()

    def all(self) -> Tensor:
        """(count,) depths, computed in float64."""
        return self.depth_m(torch.arange(self.count, dtype=torch.float64)).float()
