"""AlexNet's features, as torchvision has them (Krizhevsky, "One weird trick", 2014)."""

from __future__ import annotations

from torch import nn

from mirror.metrics.networks.trunk import Trunk, convolution


class AlexNetTrunk(Trunk):
    """AlexNet's trunk, with taps after each of five rectifiers."""

    channels = (64, 192, 384, 256, 256)
    ends = (2, 5, 8, 10, 12)
    halos = (None,) * 5
    minimum = 31

    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(
            *convolution(3, 64, 11, stride=4, padding=2),
            nn.MaxPool2d(3, 2),
            *convolution(64, 192, 5),
            nn.MaxPool2d(3, 2),
            *convolution(192, 384, 3),
            *convolution(384, 256, 3),
            *convolution(256, 256, 3),
        )
