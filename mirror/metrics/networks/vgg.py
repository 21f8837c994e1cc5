"""VGG-16's features, as torchvision has them (Simonyan and Zisserman, 2015)."""

from __future__ import annotations

from torch import nn

from mirror.metrics.networks.trunk import Trunk, convolution

_BLOCKS = ((3, 64, 2), (64, 128, 2), (128, 256, 3), (256, 512, 3), (512, 512, 3))


class Vgg16Trunk(Trunk):
    """VGG16's trunk, with taps after the last rectifier of each of five blocks."""

    channels = (64, 128, 256, 512, 512)
    ends = (4, 9, 16, 23, 30)
    halos = (2, 2, None, None, None)
    minimum = 16

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for inputs, outputs, depth in _BLOCKS:
            layers += [nn.MaxPool2d(2, 2)] if layers else []
            layers += convolution(inputs, outputs, 3)
            for _ in range(depth - 1):
                layers += convolution(outputs, outputs, 3)
        self.features = nn.Sequential(*layers)
