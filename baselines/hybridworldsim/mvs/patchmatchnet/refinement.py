"""From half to full size: a residual that the picture's edges guide."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from hybridworldsim.mvs.learned.layers import ConvNormReLU, doubling


class Refinement(nn.Module):
    """Depth as a share of its range, doubled in size, plus a learned residual."""

    def __init__(self) -> None:
        super().__init__()
        self.conv0 = ConvNormReLU(2, 3, 8)
        self.conv1 = ConvNormReLU(2, 1, 8)
        self.conv2 = ConvNormReLU(2, 8, 8)
        self.deconv = doubling(2, 8, 8)
        self.bn = nn.BatchNorm2d(8)
        self.conv3 = ConvNormReLU(2, 16, 8)
        self.res = nn.Conv2d(8, 1, 3, padding=1, bias=False)

    def forward(self, rgb: Tensor, share: Tensor) -> Tensor:
        """Refined shares.

        Args:
            rgb: (3, H, W) from 0 to 1.
            share: (H/2, W/2) from 0, the nearest depth, to 1, the farthest.

        Returns:
            (H, W).
        """
        coarse = share[None, None]
        shape = torch.relu_(self.bn(self.deconv(self.conv2(self.conv1(coarse)))))
        residual = self.res(self.conv3(torch.cat((shape, self.conv0(rgb[None])), dim=1)))
        return (functional.interpolate(coarse, scale_factor=2.0, mode="nearest") + residual)[0, 0]
