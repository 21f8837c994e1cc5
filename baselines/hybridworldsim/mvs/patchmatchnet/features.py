"""The feature pyramid: three levels at strides 8, 4 and 2."""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional

from hybridworldsim.mvs.learned.layers import ConvNormReLU


class FeaturePyramid(nn.Module):
    """Eleven convolutions that reduce the size, then upsampling with lateral connections."""

    def __init__(self) -> None:
        super().__init__()
        self.conv0 = ConvNormReLU(2, 3, 8)
        self.conv1 = ConvNormReLU(2, 8, 8)
        self.conv2 = ConvNormReLU(2, 8, 16, size=5, stride=2)
        self.conv3 = ConvNormReLU(2, 16, 16)
        self.conv4 = ConvNormReLU(2, 16, 16)
        self.conv5 = ConvNormReLU(2, 16, 32, size=5, stride=2)
        self.conv6 = ConvNormReLU(2, 32, 32)
        self.conv7 = ConvNormReLU(2, 32, 32)
        self.conv8 = ConvNormReLU(2, 32, 64, size=5, stride=2)
        self.conv9 = ConvNormReLU(2, 64, 64)
        self.conv10 = ConvNormReLU(2, 64, 64)
        self.output1 = nn.Conv2d(64, 64, 1, bias=False)
        self.inner1 = nn.Conv2d(32, 64, 1)
        self.inner2 = nn.Conv2d(16, 64, 1)
        self.output2 = nn.Conv2d(64, 32, 1, bias=False)
        self.output3 = nn.Conv2d(64, 16, 1, bias=False)

    def forward(self, rgb: Tensor) -> dict[int, Tensor]:
        """Compute the features of an image.

        Args:
            rgb: (3, H, W) from 0 to 1; H and W are multiples of 8.

        Returns:
            The features by stride: 8: (64, H/8, W/8), 4: (32, H/4, W/4), 2: (16, H/2, W/2).
        """
        half = self.conv4(self.conv3(self.conv2(self.conv1(self.conv0(rgb[None])))))
        quarter = self.conv7(self.conv6(self.conv5(half)))
        eighth = self.conv10(self.conv9(self.conv8(quarter)))
        upwards = _double(eighth) + self.inner1(quarter)
        levels = {8: self.output1(eighth), 4: self.output2(upwards)}
        levels[2] = self.output3(_double(upwards) + self.inner2(half))
        return {stride: level[0] for stride, level in levels.items()}


def _double(x: Tensor) -> Tensor:
    """Double the sides of (1, C, H, W) by bilinear interpolation."""
    return functional.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
