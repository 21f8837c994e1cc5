"""AlexNet and VGG-16 with blurred, strided and reflected sampling in place of plain strides.

Ghildyal and Liu, "Shift-tolerant Perceptual Similarity Metric" (2022). Layers are numbered as in its published weights.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from mirror.metrics.networks.trunk import Trunk, convolution

_BLOCKS = ((3, 64, 2), (64, 128, 2), (128, 256, 3), (256, 512, 3), (512, 512, 3))


class BlurredSampling(nn.Module):
    """A layer that takes every second sample after a 3x3 binomial filter, reflected by two samples at the border."""

    filt: Tensor

    def __init__(self, channels: int) -> None:
        super().__init__()
        line = torch.tensor([0.25, 0.5, 0.25])
        self.register_buffer("filt", torch.outer(line, line).expand(channels, 1, 3, 3).clone())

    def forward(self, features: Tensor) -> Tensor:
        """Map (n, c, h, w) to (n, c, (h + 3) // 2, (w + 3) // 2)."""
        padded = functional.pad(features, (2, 2, 2, 2), mode="reflect")
        return functional.conv2d(padded, self.filt, stride=2, groups=features.shape[1])


class ShiftTolerantAlexNetTrunk(Trunk):
    """The shift-tolerant AlexNet's trunk, with taps after each of five rectifiers."""

    channels = (64, 192, 384, 256, 256)
    ends = (3, 7, 11, 13, 15)
    halos = (None,) * 5
    minimum = 21

    def __init__(self) -> None:
        super().__init__()
        first, rectifier = convolution(3, 64, 11, padding=2)
        self.features = nn.Sequential(
            first,
            BlurredSampling(64),
            rectifier,
            nn.MaxPool2d(3, 1),
            BlurredSampling(64),
            *convolution(64, 192, 5),
            nn.MaxPool2d(3, 1),
            BlurredSampling(192),
            *convolution(192, 384, 3),
            *convolution(384, 256, 3),
            *convolution(256, 256, 3),
        )


class ShiftTolerantVgg16Trunk(Trunk):
    """The shift-tolerant VGG16's trunk, with taps after the last rectifier of each of five blocks."""

    channels = (64, 128, 256, 512, 512)
    ends = (4, 10, 18, 26, 34)
    halos = (None,) * 5
    minimum = 18

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for inputs, outputs, depth in _BLOCKS:
            layers += [nn.MaxPool2d(2, 1), BlurredSampling(inputs)] if layers else []
            layers += convolution(inputs, outputs, 3)
            for _ in range(depth - 1):
                layers += convolution(outputs, outputs, 3)
        self.features = nn.Sequential(*layers)
