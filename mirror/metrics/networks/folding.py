"""Batch normalisation folded into the convolution before it: the same function, one pass less over the features."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class NormalisedConvolution(nn.Module):
    """A convolution, its batch normalisation and a rectifier, named as torchvision's and TensorFlow's ports have them.

    Args:
        inputs: channels.
        outputs: channels.
        size: of the kernel, (rows, columns) or both.
        stride: of the convolution.
        padding: of the convolution.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        size: int | tuple[int, int],
        stride: int = 1,
        padding: int | tuple[int, int] = 0,
    ) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, size, stride, padding, bias=False)
        self.bn: nn.Module = nn.BatchNorm2d(outputs, eps=1e-3)

    def forward(self, features: Tensor) -> Tensor:
        """Map (n, inputs, h, w) to (n, outputs, h', w')."""
        normalised: Tensor = self.bn(self.conv(features))
        return normalised.relu_()

    def fold(self) -> None:
        """Fold the normalisation into the convolution; the products are taken in float64 and rounded once."""
        if isinstance(self.bn, nn.BatchNorm2d):
            weight, bias = folded(self.conv.weight, self.bn)
            conv = self.conv
            self.conv = nn.Conv2d(
                conv.in_channels,
                conv.out_channels,
                conv.kernel_size,  # type: ignore[arg-type]
                conv.stride,  # type: ignore[arg-type]
                conv.padding,  # type: ignore[arg-type]
            )
            self.conv.weight = nn.Parameter(weight, requires_grad=False)
            self.conv.bias = nn.Parameter(bias, requires_grad=False)
            self.bn = nn.Identity()


def folded(weight: Tensor, norm: nn.BatchNorm2d) -> tuple[Tensor, Tensor]:
    """Fold a batch normalisation into the weight of its convolution; return the new weight and bias.

    Args:
        weight: (outputs, inputs, rows, columns), of a convolution without a bias.
        norm: of its outputs, with running statistics.
    """
    mean, variance = norm.running_mean, norm.running_var
    if mean is None or variance is None:
        raise ValueError("a batch normalisation without running statistics cannot be folded")
    scale = norm.weight.double() / torch.sqrt(variance.double() + norm.eps)
    kind = weight.dtype
    return (weight.double() * scale.reshape(-1, 1, 1, 1)).to(kind), (norm.bias.double() - mean.double() * scale).to(
        kind
    )
