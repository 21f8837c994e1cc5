"""Upsampling from half to full size by a residual that follows the edges of the image."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from hybridworldsim.mvs.learned.layers import ConvNormReLU, make_doubling_convolution


class PatchmatchRefinement(nn.Module):
    """A network for the residual that is added to the depth map of doubled size, as a share of the range."""

    def __init__(self) -> None:
        super().__init__()
        self.conv0 = ConvNormReLU(2, 3, 8)
        self.conv1 = ConvNormReLU(2, 1, 8)
        self.conv2 = ConvNormReLU(2, 8, 8)
        self.deconv = make_doubling_convolution(2, 8, 8)
        self.bn = nn.BatchNorm2d(8)
        self.conv3 = ConvNormReLU(2, 16, 8)
        self.res = nn.Conv2d(8, 1, 3, padding=1, bias=False)

    def forward(self, rgb: Tensor, share: Tensor) -> Tensor:
        """Compute the residual.

        Args:
            rgb: (3, H, W) from 0 to 1.
            share: (H/2, W/2) depth from 0, the nearest, to 1, the farthest.

        Returns:
            (H, W).
        """
        shape = torch.relu_(self.bn(self.deconv(self.conv2(self.conv1(share[None, None])))))
        return self.res(self.conv3(torch.cat((shape, self.conv0(rgb[None])), dim=1)))[0, 0]
