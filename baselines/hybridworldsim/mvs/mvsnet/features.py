"""The features of an image, at a quarter of its size."""

from __future__ import annotations

from torch import Tensor, nn

from hybridworldsim.mvs.learned.layers import ConvNormReLU

CHANNELS = 32


class FeatureNet(nn.Module):
    """Eight convolutions, of which two halve the sides."""

    def __init__(self) -> None:
        super().__init__()
        self.conv0 = ConvNormReLU(2, 3, 8)
        self.conv1 = ConvNormReLU(2, 8, 8)
        self.conv2 = ConvNormReLU(2, 8, 16, size=5, stride=2)
        self.conv3 = ConvNormReLU(2, 16, 16)
        self.conv4 = ConvNormReLU(2, 16, 16)
        self.conv5 = ConvNormReLU(2, 16, 32, size=5, stride=2)
        self.conv6 = ConvNormReLU(2, 32, 32)
        self.feature = nn.Conv2d(32, CHANNELS, 3, padding=1)

    def forward(self, rgb: Tensor) -> Tensor:
        """Compute features (32, H/4, W/4) of RGB (3, H, W) from 0 to 1."""
        half = self.conv4(self.conv3(self.conv2(self.conv1(self.conv0(rgb[None])))))
        return self.feature(self.conv6(self.conv5(half)))[0]
