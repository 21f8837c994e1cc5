"""Smooths the noisy cost of each depth plane to a score, by a U-shaped network of 3D convolutions."""

from __future__ import annotations

from torch import Tensor, nn

from hybridworldsim.mvs.learned.layers import ConvNormReLU, make_doubling_convolution
from hybridworldsim.mvs.mvsnet.features import CHANNELS


class CostRegularisation(nn.Module):
    """A network that halves the sides three times and doubles them three times, with added skip connections."""

    def __init__(self) -> None:
        super().__init__()
        self.conv0 = ConvNormReLU(3, CHANNELS, 8)
        self.conv1 = ConvNormReLU(3, 8, 16, stride=2)
        self.conv2 = ConvNormReLU(3, 16, 16)
        self.conv3 = ConvNormReLU(3, 16, 32, stride=2)
        self.conv4 = ConvNormReLU(3, 32, 32)
        self.conv5 = ConvNormReLU(3, 32, 64, stride=2)
        self.conv6 = ConvNormReLU(3, 64, 64)
        self.conv7 = _make_upsampling_block(64, 32)
        self.conv9 = _make_upsampling_block(32, 16)
        self.conv11 = _make_upsampling_block(16, 8)
        self.prob = nn.Conv3d(8, 1, 3, padding=1)

    def forward(self, volume: Tensor) -> Tensor:
        """Compute scores (D, H, W) of a cost volume (32, D, H, W); each side is a multiple of 8."""
        full = self.conv0(volume[None])
        half = self.conv2(self.conv1(full))
        quarter = self.conv4(self.conv3(half))
        up = self.conv7(self.conv6(self.conv5(quarter))).add_(quarter)
        up = self.conv9(up).add_(half)
        return self.prob(self.conv11(up).add_(full))[0, 0]


def _make_upsampling_block(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(make_doubling_convolution(3, inputs, outputs), nn.BatchNorm3d(outputs), nn.ReLU(inplace=True))
