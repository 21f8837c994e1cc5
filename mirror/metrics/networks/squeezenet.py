"""SqueezeNet 1.1's features, as torchvision has them (Iandola et al., 2016)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from mirror.metrics.networks.trunk import Trunk, convolution


class Fire(nn.Module):
    """A 1x1 convolution that narrows, then a 1x1 and a 3x3 convolution side by side."""

    def __init__(self, inputs: int, narrow: int, wide: int) -> None:
        super().__init__()
        self.squeeze = nn.Conv2d(inputs, narrow, 1)
        self.expand1x1 = nn.Conv2d(narrow, wide, 1)
        self.expand3x3 = nn.Conv2d(narrow, wide, 3, padding=1)

    def forward(self, features: Tensor) -> Tensor:
        """Map (n, inputs, h, w) to (n, 2 wide, h, w)."""
        narrow = self.squeeze(features).relu_()
        return torch.cat([self.expand1x1(narrow), self.expand3x3(narrow)], dim=1).relu_()


class SqueezeNetTrunk(Trunk):
    """SqueezeNet's trunk, with taps after the first rectifier and after six of the fire modules."""

    channels = (64, 128, 256, 384, 384, 512, 512)
    ends = (2, 5, 8, 10, 11, 12, 13)
    halos = (None,) * 7
    minimum = 17

    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(
            *convolution(3, 64, 3, stride=2, padding=0),
            nn.MaxPool2d(3, 2, ceil_mode=True),
            Fire(64, 16, 64),
            Fire(128, 16, 64),
            nn.MaxPool2d(3, 2, ceil_mode=True),
            Fire(128, 32, 128),
            Fire(256, 32, 128),
            nn.MaxPool2d(3, 2, ceil_mode=True),
            Fire(256, 48, 192),
            Fire(384, 48, 192),
            Fire(384, 64, 256),
            Fire(512, 64, 256),
        )
