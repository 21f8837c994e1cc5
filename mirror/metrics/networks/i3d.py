"""Inflated Inception v1 for videos, Kinetics-400 (Carreira and Zisserman, "Quo Vadis, Action Recognition?", 2017).

Named and computed as in the ports that FVD uses (VideoGPT, TATS, cd-fvd): TensorFlow's "same" padding, normalisation
with an epsilon of 1e-5, logits averaged over time.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

Triple = tuple[int, int, int]

MINIMUM_FRAMES = 9
"""The last pooling spans two steps of time, and there are ceil(frames / 8)."""

_MIXED = {
    "Mixed_3b": (192, (64, 96, 128, 16, 32, 32)),
    "Mixed_3c": (256, (128, 128, 192, 32, 96, 64)),
    "Mixed_4b": (480, (192, 96, 208, 16, 48, 64)),
    "Mixed_4c": (512, (160, 112, 224, 24, 64, 64)),
    "Mixed_4d": (512, (128, 128, 256, 24, 64, 64)),
    "Mixed_4e": (512, (112, 144, 288, 32, 64, 64)),
    "Mixed_4f": (528, (256, 160, 320, 32, 128, 128)),
    "Mixed_5b": (832, (256, 160, 320, 32, 128, 128)),
    "Mixed_5c": (832, (384, 192, 384, 48, 128, 128)),
}


def _same(features: Tensor, kernel: Triple, stride: Triple) -> Tensor:
    """Zeros around, so that the result has ceil(size / stride); the odd one goes behind."""
    sides: list[int] = []
    for size, span, step in zip(reversed(features.shape[2:]), reversed(kernel), reversed(stride)):
        missing = max(span - (size % step or step), 0)
        sides += [missing // 2, missing - missing // 2]
    return functional.pad(features, sides) if any(sides) else features


def _max_pool(features: Tensor, kernel: Triple, stride: Triple) -> Tensor:
    return functional.max_pool3d(_same(features, kernel, stride), kernel, stride)


class Unit3d(nn.Module):
    """A convolution, its normalisation and a rectifier."""

    def __init__(self, inputs: int, outputs: int, size: int = 1, stride: int = 1) -> None:
        super().__init__()
        self.conv3d = nn.Conv3d(inputs, outputs, size, stride, bias=False)
        self.bn = nn.BatchNorm3d(outputs, eps=1e-5)
        self._kernel, self._stride = (size,) * 3, (stride,) * 3

    def forward(self, features: Tensor) -> Tensor:
        """Map (n, inputs, t, h, w) to (n, outputs, t', h', w')."""
        return self.bn(self.conv3d(_same(features, self._kernel, self._stride))).relu_()


class Mixed3d(nn.Module):
    """An I3D block: 1x1x1, twice 3x3x3 and pooling, side by side."""

    def __init__(self, inputs: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.b0 = Unit3d(inputs, widths[0])
        self.b1a = Unit3d(inputs, widths[1])
        self.b1b = Unit3d(widths[1], widths[2], 3)
        self.b2a = Unit3d(inputs, widths[3])
        self.b2b = Unit3d(widths[3], widths[4], 3)
        self.b3b = Unit3d(inputs, widths[5])

    def forward(self, features: Tensor) -> Tensor:
        """Map (n, inputs, t, h, w) to (n, sum of widths, t, h, w)."""
        pooled = _max_pool(features, (3, 3, 3), (1, 1, 1))
        return torch.cat(
            [self.b0(features), self.b1b(self.b1a(features)), self.b2b(self.b2a(features)), self.b3b(pooled)], dim=1
        )


class _Logits(nn.Module):
    """The last 1x1x1 convolution, with a bias."""

    def __init__(self) -> None:
        super().__init__()
        self.conv3d = nn.Conv3d(1024, 400, 1)

    def forward(self, features: Tensor) -> Tensor:
        return self.conv3d(features)


class InflatedInception(nn.Module):
    """The network of FVD: clips to logits (n, 400)."""

    def __init__(self) -> None:
        super().__init__()
        self.Conv3d_1a_7x7 = Unit3d(3, 64, 7, stride=2)
        self.Conv3d_2b_1x1 = Unit3d(64, 64)
        self.Conv3d_2c_3x3 = Unit3d(64, 192, 3)
        for name, (inputs, widths) in _MIXED.items():
            self.add_module(name, Mixed3d(inputs, widths))
        self.logits = _Logits()

    def forward(self, clips: Tensor) -> Tensor:
        """Return the logits, averaged over time.

        Args:
            clips: (n, 3, t, 224, 224), -1 to 1, t of 9 or more.
        """
        features = _max_pool(self.Conv3d_1a_7x7(clips), (1, 3, 3), (1, 2, 2))
        features = _max_pool(self.Conv3d_2c_3x3(self.Conv3d_2b_1x1(features)), (1, 3, 3), (1, 2, 2))
        for name in _MIXED:
            if name == "Mixed_4b":
                features = _max_pool(features, (3, 3, 3), (2, 2, 2))
            elif name == "Mixed_5b":
                features = _max_pool(features, (2, 2, 2), (2, 2, 2))
            features = self.get_submodule(name)(features)
        pooled = functional.avg_pool3d(features, (2, 7, 7), stride=1)
        return self.logits(pooled).mean(dim=(2, 3, 4))
