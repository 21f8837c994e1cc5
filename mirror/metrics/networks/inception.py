"""The Inception v3 of the Fréchet inception distance: TensorFlow's of 2015-12-05, as ported for PyTorch.

It differs from torchvision's: average pooling leaves the padding out of the mean, the last block pools by maximum, and
it has 1008 classes. Architecture: Szegedy et al., "Rethinking the Inception Architecture for Computer Vision" (2015).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from mirror.metrics.networks.folding import NormalisedConvolution as Conv


def _mean_3x3(features: Tensor) -> Tensor:
    return functional.avg_pool2d(features, 3, stride=1, padding=1, count_include_pad=False)


def _max_3x3(features: Tensor) -> Tensor:
    return functional.max_pool2d(features, 3, stride=1, padding=1)


class BlockA(nn.Module):
    """An Inception block at 35 x 35: 1x1, 5x5, twice 3x3 and pooling, side by side."""

    def __init__(self, inputs: int, pooled: int) -> None:
        super().__init__()
        self.branch1x1 = Conv(inputs, 64, 1)
        self.branch5x5_1 = Conv(inputs, 48, 1)
        self.branch5x5_2 = Conv(48, 64, 5, padding=2)
        self.branch3x3dbl_1 = Conv(inputs, 64, 1)
        self.branch3x3dbl_2 = Conv(64, 96, 3, padding=1)
        self.branch3x3dbl_3 = Conv(96, 96, 3, padding=1)
        self.branch_pool = Conv(inputs, pooled, 1)

    def forward(self, features: Tensor) -> Tensor:
        """Map (n, inputs, h, w) to (n, 224 + pooled, h, w)."""
        return torch.cat(
            [
                self.branch1x1(features),
                self.branch5x5_2(self.branch5x5_1(features)),
                self.branch3x3dbl_3(self.branch3x3dbl_2(self.branch3x3dbl_1(features))),
                self.branch_pool(_mean_3x3(features)),
            ],
            dim=1,
        )


class BlockB(nn.Module):
    """An Inception block that reduces 35 x 35 to 17 x 17."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.branch3x3 = Conv(inputs, 384, 3, stride=2)
        self.branch3x3dbl_1 = Conv(inputs, 64, 1)
        self.branch3x3dbl_2 = Conv(64, 96, 3, padding=1)
        self.branch3x3dbl_3 = Conv(96, 96, 3, stride=2)

    def forward(self, features: Tensor) -> Tensor:
        """Map (n, inputs, h, w) to (n, inputs + 480, h', w')."""
        twice = self.branch3x3dbl_3(self.branch3x3dbl_2(self.branch3x3dbl_1(features)))
        return torch.cat([self.branch3x3(features), twice, functional.max_pool2d(features, 3, stride=2)], dim=1)


class BlockC(nn.Module):
    """An Inception block at 17 x 17: 7x7 as a row after a column."""

    def __init__(self, inputs: int, narrow: int) -> None:
        super().__init__()
        row, column = {"size": (1, 7), "padding": (0, 3)}, {"size": (7, 1), "padding": (3, 0)}
        self.branch1x1 = Conv(inputs, 192, 1)
        self.branch7x7_1 = Conv(inputs, narrow, 1)
        self.branch7x7_2 = Conv(narrow, narrow, **row)  # type: ignore[arg-type]
        self.branch7x7_3 = Conv(narrow, 192, **column)  # type: ignore[arg-type]
        self.branch7x7dbl_1 = Conv(inputs, narrow, 1)
        self.branch7x7dbl_2 = Conv(narrow, narrow, **column)  # type: ignore[arg-type]
        self.branch7x7dbl_3 = Conv(narrow, narrow, **row)  # type: ignore[arg-type]
        self.branch7x7dbl_4 = Conv(narrow, narrow, **column)  # type: ignore[arg-type]
        self.branch7x7dbl_5 = Conv(narrow, 192, **row)  # type: ignore[arg-type]
        self.branch_pool = Conv(inputs, 192, 1)

    def forward(self, features: Tensor) -> Tensor:
        """Map (n, inputs, h, w) to (n, 768, h, w)."""
        once = self.branch7x7_3(self.branch7x7_2(self.branch7x7_1(features)))
        twice = self.branch7x7dbl_3(self.branch7x7dbl_2(self.branch7x7dbl_1(features)))
        twice = self.branch7x7dbl_5(self.branch7x7dbl_4(twice))
        return torch.cat([self.branch1x1(features), once, twice, self.branch_pool(_mean_3x3(features))], dim=1)


class BlockD(nn.Module):
    """An Inception block that reduces 17 x 17 to 8 x 8."""

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self.branch3x3_1 = Conv(inputs, 192, 1)
        self.branch3x3_2 = Conv(192, 320, 3, stride=2)
        self.branch7x7x3_1 = Conv(inputs, 192, 1)
        self.branch7x7x3_2 = Conv(192, 192, (1, 7), padding=(0, 3))
        self.branch7x7x3_3 = Conv(192, 192, (7, 1), padding=(3, 0))
        self.branch7x7x3_4 = Conv(192, 192, 3, stride=2)

    def forward(self, features: Tensor) -> Tensor:
        """Map (n, inputs, h, w) to (n, inputs + 512, h', w')."""
        long = self.branch7x7x3_4(self.branch7x7x3_3(self.branch7x7x3_2(self.branch7x7x3_1(features))))
        short = self.branch3x3_2(self.branch3x3_1(features))
        return torch.cat([short, long, functional.max_pool2d(features, 3, stride=2)], dim=1)


class BlockE(nn.Module):
    """An Inception block at 8 x 8: 3x3 as a row beside a column.

    Args:
        inputs: channels.
        by_maximum: pool by maximum, as the last block of this network does, and not by mean.
    """

    def __init__(self, inputs: int, *, by_maximum: bool) -> None:
        super().__init__()
        self.branch1x1 = Conv(inputs, 320, 1)
        self.branch3x3_1 = Conv(inputs, 384, 1)
        self.branch3x3_2a = Conv(384, 384, (1, 3), padding=(0, 1))
        self.branch3x3_2b = Conv(384, 384, (3, 1), padding=(1, 0))
        self.branch3x3dbl_1 = Conv(inputs, 448, 1)
        self.branch3x3dbl_2 = Conv(448, 384, 3, padding=1)
        self.branch3x3dbl_3a = Conv(384, 384, (1, 3), padding=(0, 1))
        self.branch3x3dbl_3b = Conv(384, 384, (3, 1), padding=(1, 0))
        self.branch_pool = Conv(inputs, 192, 1)
        self._pool = _max_3x3 if by_maximum else _mean_3x3

    def forward(self, features: Tensor) -> Tensor:
        """Map (n, inputs, h, w) to (n, 2048, h, w)."""
        once = self.branch3x3_1(features)
        twice = self.branch3x3dbl_2(self.branch3x3dbl_1(features))
        return torch.cat(
            [
                self.branch1x1(features),
                self.branch3x3_2a(once),
                self.branch3x3_2b(once),
                self.branch3x3dbl_3a(twice),
                self.branch3x3dbl_3b(twice),
                self.branch_pool(self._pool(features)),
            ],
            dim=1,
        )


class FidInception(nn.Module):
    """The network of FID: images to pooled features (n, 2048)."""

    def __init__(self) -> None:
        super().__init__()
        self.Conv2d_1a_3x3 = Conv(3, 32, 3, stride=2)
        self.Conv2d_2a_3x3 = Conv(32, 32, 3)
        self.Conv2d_2b_3x3 = Conv(32, 64, 3, padding=1)
        self.Conv2d_3b_1x1 = Conv(64, 80, 1)
        self.Conv2d_4a_3x3 = Conv(80, 192, 3)
        self.Mixed_5b = BlockA(192, 32)
        self.Mixed_5c = BlockA(256, 64)
        self.Mixed_5d = BlockA(288, 64)
        self.Mixed_6a = BlockB(288)
        self.Mixed_6b = BlockC(768, 128)
        self.Mixed_6c = BlockC(768, 160)
        self.Mixed_6d = BlockC(768, 160)
        self.Mixed_6e = BlockC(768, 192)
        self.Mixed_7a = BlockD(768)
        self.Mixed_7b = BlockE(1280, by_maximum=False)
        self.Mixed_7c = BlockE(2048, by_maximum=True)
        self.fc = nn.Linear(2048, 1008)

    def forward(self, images: Tensor) -> Tensor:
        """Return the features of the last pooling.

        Args:
            images: (n, 3, 299, 299), (grey - 128) / 128.
        """
        features = self.Conv2d_2b_3x3(self.Conv2d_2a_3x3(self.Conv2d_1a_3x3(images)))
        features = functional.max_pool2d(features, 3, stride=2)
        features = self.Conv2d_4a_3x3(self.Conv2d_3b_1x1(features))
        features = functional.max_pool2d(features, 3, stride=2)
        features = self.Mixed_5d(self.Mixed_5c(self.Mixed_5b(features)))
        features = self.Mixed_6c(self.Mixed_6b(self.Mixed_6a(features)))
        features = self.Mixed_6e(self.Mixed_6d(features))
        features = self.Mixed_7c(self.Mixed_7b(self.Mixed_7a(features)))
        return features.mean(dim=(2, 3))

    def fold(self) -> FidInception:
        """Fold every normalisation in place, and change to the layout in which the CPU convolves fastest."""
        for module in self.modules():
            if isinstance(module, Conv):
                module.fold()
        return self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
