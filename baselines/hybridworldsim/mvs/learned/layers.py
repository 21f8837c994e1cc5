"""Convolutions that are followed by batch normalisation and a rectifier, named as in public checkpoints."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

Layer = nn.Conv2d | nn.Conv3d | nn.ConvTranspose2d | nn.ConvTranspose3d


class ConvNorm(nn.Module):
    """Convolution without bias and batch normalisation; keys ``conv.weight``, ``bn.*``.

    Args:
        dimensions: 2 for pictures, 3 for volumes.
        inputs: channels.
        outputs: channels.
        size: of the kernel, odd; as many samples come out as went in, divided by the stride.
        stride: of the convolution.
    """

    def __init__(self, dimensions: Literal[2, 3], inputs: int, outputs: int, *, size: int = 3, stride: int = 1) -> None:
        super().__init__()
        convolution, norm = (nn.Conv2d, nn.BatchNorm2d) if dimensions == 2 else (nn.Conv3d, nn.BatchNorm3d)
        self.conv = convolution(inputs, outputs, size, stride, size // 2, bias=False)
        self.bn: nn.BatchNorm2d | nn.BatchNorm3d | nn.Identity = norm(outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Normalised responses."""
        return self.bn(self.conv(x))


class ConvNormReLU(ConvNorm):
    """`ConvNorm`, then a rectifier."""

    def forward(self, x: Tensor) -> Tensor:
        """Rectified responses."""
        return torch.relu_(super().forward(x))


def doubling(dimensions: Literal[2, 3], inputs: int, outputs: int) -> Layer:
    """A transposed 3-tap convolution that doubles every side."""
    convolution = nn.ConvTranspose2d if dimensions == 2 else nn.ConvTranspose3d
    return convolution(inputs, outputs, 3, stride=2, padding=1, output_padding=1, bias=False)


def fold_norms(network: nn.Module) -> None:
    """Fold the normalisations of filled `ConvNorm` layers into their convolutions: the same function, fewer passes."""
    network.eval()
    for module in network.modules():
        if isinstance(module, ConvNorm) and not isinstance(module.bn, nn.Identity):
            module.conv = fuse_conv_bn_eval(module.conv, module.bn)
            module.bn = nn.Identity()
