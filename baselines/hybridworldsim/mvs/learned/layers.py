"""Convolutions with batch normalisation and a rectifier; parameters are named as in public checkpoints."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

Layer = nn.Conv2d | nn.Conv3d | nn.ConvTranspose2d | nn.ConvTranspose3d


class ConvNorm(nn.Module):
    """A convolution without bias, then batch normalisation; its keys are ``conv.weight`` and ``bn.*``.

    Args:
        dimensions: 2 for images, 3 for volumes.
        inputs: number of input channels.
        outputs: number of output channels.
        size: side of the kernel, odd; the output has the size of the input divided by the stride.
        stride: stride of the convolution.
    """

    def __init__(self, dimensions: Literal[2, 3], inputs: int, outputs: int, *, size: int = 3, stride: int = 1) -> None:
        super().__init__()
        convolution, norm = (nn.Conv2d, nn.BatchNorm2d) if dimensions == 2 else (nn.Conv3d, nn.BatchNorm3d)
        self.conv = convolution(inputs, outputs, size, stride, size // 2, bias=False)
        self.bn: nn.BatchNorm2d | nn.BatchNorm3d | nn.Identity = norm(outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Convolve and normalise."""
        return self.bn(self.conv(x))


class ConvNormReLU(ConvNorm):
    """`ConvNorm` followed by a rectifier."""

    def forward(self, x: Tensor) -> Tensor:
        """Convolve, normalise and rectify."""
        return torch.relu_(super().forward(x))


def make_doubling_convolution(dimensions: Literal[2, 3], inputs: int, outputs: int) -> Layer:
    """Make a transposed 3-tap convolution that doubles each side."""
    convolution = nn.ConvTranspose2d if dimensions == 2 else nn.ConvTranspose3d
    return convolution(inputs, outputs, 3, stride=2, padding=1, output_padding=1, bias=False)


def fold_norms(network: nn.Module) -> None:
    """Fold the batch normalisation of each `ConvNorm` layer into its convolution; the layers must hold their weights.

    The network computes the same function in fewer passes.
    """
    network.eval()
    for module in network.modules():
        if isinstance(module, ConvNorm) and not isinstance(module.bn, nn.Identity):
            module.conv = fuse_conv_bn_eval(module.conv, module.bn)
            module.bn = nn.Identity()
