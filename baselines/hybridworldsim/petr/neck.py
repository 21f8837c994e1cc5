"""CPFPN: a feature pyramid whose output convolution exists at the finest level only."""

from __future__ import annotations

from collections.abc import Sequence

import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn


class Convolution(nn.Module):
    """A convolution, named as in the published checkpoints."""

    def __init__(self, inputs: int, outputs: int, kernel: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, kernel, padding=kernel // 2)

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, inputs, H, W) to (N, outputs, H, W)."""
        out: Tensor = self.conv(x)
        return out


class Neck(nn.Module):
    """A neck that adds coarse features to the finest ones.

    Args:
        channels: channels of the backbone's outputs, finest first.
        dim: channels of the output.
    """

    def __init__(self, channels: Sequence[int], dim: int) -> None:
        super().__init__()
        self.lateral_convs = nn.ModuleList(Convolution(width, dim, 1) for width in channels)
        self.fpn_convs = nn.ModuleList([Convolution(dim, dim, 3)])

    def forward(self, features: Sequence[Tensor]) -> Tensor:
        """Map the features of all levels to features (N, dim, H, W) at the finest level."""
        laterals = [lateral(x) for lateral, x in zip(self.lateral_convs, features)]
        for level in range(len(laterals) - 1, 0, -1):
            size = laterals[level - 1].shape[2:]
            laterals[level - 1] = laterals[level - 1] + F.interpolate(laterals[level], size=size, mode="nearest")
        out: Tensor = self.fpn_convs[0](laterals[0])
        return out
