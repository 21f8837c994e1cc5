"""A residual of depth that the picture guides.

The published PyTorch code declares this network but cannot run it, and its own evaluation leaves it out. Names and
shapes are its, what is computed is the paper's (section 3.4): depth as a share of its range, the picture at depth's
size, and no rectifier at the end, so that the residual can be negative.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from hybridworldsim.mvs.learned.layers import ConvNorm, ConvNormReLU


class Refinement(nn.Module):
    """Four convolutions of the picture and the depth."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = ConvNormReLU(2, 4, 32)
        self.conv2 = ConvNormReLU(2, 32, 32)
        self.conv3 = ConvNormReLU(2, 32, 32)
        self.res = ConvNorm(2, 32, 1)

    def forward(self, rgb: Tensor, share: Tensor) -> Tensor:
        """What is to be added to shares (H, W) from 0, the nearest depth, to 1; RGB (3, h, w) from 0 to 1."""
        small = functional.interpolate(rgb[None], size=share.shape, mode="bilinear", align_corners=False)
        stacked = torch.cat((small, share[None, None]), dim=1)
        return self.res(self.conv3(self.conv2(self.conv1(stacked))))[0, 0]
