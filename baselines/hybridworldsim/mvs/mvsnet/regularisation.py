"""From the noisy cost of every plane to a smooth score: a U of 3D convolutions."""

from __future__ import annotations

from torch import Tensor, nn

from hybridworldsim.mvs.learned.layers import ConvNormReLU, doubling
from hybridworldsim.mvs.mvsnet.features import CHANNELS


class CostRegularisation(nn.Module):
    """Three halvings and three doublings, joined by sums."""

    def __init__(self) -> None:
        super().__init__()
        self.conv0 = ConvNormReLU(3, CHANNELS, 8)
        self.conv1 = ConvNormReLU(3, 8, 16, stride=2)
        self.conv2 = ConvNormReLU(3, 16, 16)
        self.conv3 = ConvNormReLU(3, 16, 32, stride=2)
        self.conv4 = ConvNormReLU(3, 32, 32)
        self.conv5 = ConvNormReLU(3, 32, 64, stride=2)
        self.conv6 = ConvNormReLU(3, 64, 64)
        self.conv7 = _upwards(64, 32)
        self.conv9 = _upwards(32, 16)
        self.conv11 = _upwards(16, 8)
        self.prob = nn.Conv3d(8, 1, 3, padding=1)

    def forward(self, volume: Tensor) -> Tensor:
        """(D, H, W) scores of a cost volume (32, D, H, W); every side is a multiple of 8."""
        whole = self.conv0(volume[None])
        half = self.conv2(self.conv1(whole))
        quarter = self.conv4(self.conv3(half))
        up = self.conv7(self.conv6(self.conv5(quarter))).add_(quarter)
        up = self.conv9(up).add_(half)
        return self.prob(self.conv11(up).add_(whole))[0, 0]


def _upwards(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(doubling(3, inputs, outputs), nn.BatchNorm3d(outputs), nn.ReLU(inplace=True))
