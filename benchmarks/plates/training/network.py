"""The network: a small convolutional one with a feature pyramid, without anchors (as Z. Ge et al., "YOLOX", 2021)."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

STRIDES: Final = (8, 16, 32, 64)
_CHANNELS: Final = (16, 32, 64, 96, 128, 128)
_BLOCKS: Final = (1, 2, 2, 2, 1)
_PYRAMID: Final = 48
_UNIT: Final = 4.0
"""Width and height of a box of which the network's output is 0, in strides."""


class PlateNetwork(nn.Module):
    """Finds plates in images whose sides are multiples of 64.

    Args:
        channels: channels of the stem and of each stage.
        blocks: residual blocks of each stage.
        pyramid: channels of the pyramid and of its heads.
    """

    def __init__(
        self, channels: tuple[int, ...] = _CHANNELS, blocks: tuple[int, ...] = _BLOCKS, pyramid: int = _PYRAMID
    ) -> None:
        super().__init__()
        self.stem = _convolution(3, channels[0], 2)
        self.stages = nn.ModuleList(
            nn.Sequential(_convolution(before, after, 2), *(_Block(after) for _ in range(count)))
            for before, after, count in zip(channels, channels[1:], blocks)
        )
        used = channels[2:]
        self.lateral = nn.ModuleList(nn.Conv2d(count, pyramid, 1) for count in used)
        self.smooth = nn.ModuleList(_convolution(pyramid, pyramid) for _ in used)
        self.head = _convolution(pyramid, pyramid)
        self.out = nn.Conv2d(pyramid, 5, 3, 1, 1)
        nn.init.normal_(self.out.weight, std=0.01)
        # Few cells find a plate: scores begin at 1 %.
        self.out.bias = nn.Parameter(torch.tensor([0.0, 0.0, 0.0, 0.0, -4.6]))

    def forward(self, images: Tensor) -> Tensor:
        """Return the outputs (B, N, 5) of all cells: offsets of the middle, logarithms of width and height, and logit.

        Args:
            images: (B, 3, H, W), RGB, 0 to 255.
        """
        features = []
        x = self.stem(images * (1.0 / 128.0) - 1.0)
        for number, stage in enumerate(self.stages):
            x = stage(x)
            if number:
                features.append(x)
        outputs: list[Tensor] = []
        above: Tensor | None = None
        for feature, lateral, smooth in zip(reversed(features), reversed(self.lateral), reversed(self.smooth)):
            own = lateral(feature)
            if above is not None:
                own = own + functional.interpolate(above, scale_factor=2.0, mode="nearest")
            above = smooth(own)
            outputs.append(self.out(self.head(above)).flatten(2).transpose(1, 2))
        return torch.cat(outputs[::-1], dim=1)


class Decoded(nn.Module):
    """The network with boxes in pixels, as it is exported.

    Args:
        network: the network.
    """

    def __init__(self, network: PlateNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> Tensor:
        """Return the boxes and scores (B, N, 5) of images (B, 3, H, W): left, top, right, bottom, score."""
        raw = self.network(images)
        cells = make_cells(images)
        return torch.cat([decode(raw, cells), raw[..., 4:].sigmoid()], dim=-1)


def make_cells(images: Tensor) -> Tensor:
    """Return the middle and stride (N, 3) of the cells of images (B, 3, H, W)."""
    parts = []
    for stride in STRIDES:
        v = torch.arange(images.shape[2] // stride, device=images.device)
        u = torch.arange(images.shape[3] // stride, device=images.device)
        grid_v, grid_u = torch.meshgrid(v, u, indexing="ij")
        middle = (torch.stack([grid_u, grid_v], dim=-1).reshape(-1, 2).float() + 0.5) * stride
        parts.append(torch.cat([middle, torch.full_like(middle[:, :1], float(stride))], dim=1))
    return torch.cat(parts)


def decode(raw: Tensor, cells: Tensor) -> Tensor:
    """Return the boxes (B, N, 4) of outputs (B, N, 5) and cells (N, 3)."""
    stride = cells[:, 2:]
    middle = cells[:, :2] + raw[..., :2] * stride
    half = 0.5 * _UNIT * stride * raw[..., 2:4].clamp(-5.0, 4.0).exp()
    return torch.cat([middle - half, middle + half], dim=-1)


class _Block(nn.Module):
    """A residual block with a narrow middle."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = _convolution(channels, channels // 2)
        self.second = nn.Conv2d(channels // 2, channels, 3, 1, 1, bias=False)
        self.norm = nn.BatchNorm2d(channels)

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(x + self.norm(self.second(self.first(x))))


def _convolution(before: int, after: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(before, after, 3, stride, 1, bias=False), nn.BatchNorm2d(after), nn.ReLU(inplace=True)
    )
