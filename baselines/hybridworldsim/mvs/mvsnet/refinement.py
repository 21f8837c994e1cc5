"""A network that computes a residual of depth from the image and the depth.

The published PyTorch code declares this network but cannot run it, and its own evaluation leaves it out. Names and
shapes follow that code; the computation follows the paper (section 3.4): depth as a share of its range, the image at
the size of the depth map, and no rectifier at the end, so that the residual can be negative.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from hybridworldsim.mvs.learned.layers import ConvNorm, ConvNormReLU


class Refinement(nn.Module):
    """Four convolutions of the image and the depth."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = ConvNormReLU(2, 4, 32)
        self.conv2 = ConvNormReLU(2, 32, 32)
        self.conv3 = ConvNormReLU(2, 32, 32)
        self.res = ConvNorm(2, 32, 1)

    def forward(self, rgb: Tensor, share: Tensor) -> Tensor:
        """Compute the residual (H, W) of depth.

        Args:
            rgb: (3, h, w) from 0 to 1.
            share: (H, W) depth from 0, the nearest, to 1, the farthest.
        """
        small = functional.interpolate(rgb[None], size=share.shape, mode="bilinear", align_corners=False)
        stacked = torch.cat((small, share[None, None]), dim=1)
        return self.res(self.conv3(self.conv2(self.conv1(stacked))))[0, 0]
