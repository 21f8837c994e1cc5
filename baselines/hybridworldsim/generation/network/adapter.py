"""Adapters: images to features of the token grid, whose last convolutions begin at zero.

The blocks are those of T2I-Adapter (C. Mou et al., 2024), with the names of OpenDWM's state dict.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, interpolate, pixel_unshuffle, relu

from hybridworldsim.generation.network.configuration import AdapterConfig


class _Residual(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.block1 = nn.Conv2d(width, width, 3, padding=1)
        self.block2 = nn.Conv2d(width, width, 1)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.block2(relu(self.block1(x)))


class _Block(nn.Module):
    """Halve the resolution if asked, change the number of channels if needed, then residual units."""

    def __init__(self, channels: int, width: int, resnets: int, shrink: int) -> None:
        super().__init__()
        self.shrink = shrink
        self.in_conv = nn.Identity() if channels == width else nn.Conv2d(channels, width, 1)
        self.resnets = nn.Sequential(*(_Residual(width) for _ in range(resnets)))

    def forward(self, x: Tensor) -> Tensor:
        if self.shrink > 1:
            x = avg_pool2d(x, self.shrink, ceil_mode=True)
        return self.resnets(self.in_conv(x))


def _zero_convolution(channels: int, out: int) -> nn.Conv2d:
    convolution = nn.Conv2d(channels, out, 1)
    nn.init.zeros_(convolution.weight)
    nn.init.zeros_(convolution.bias)  # type: ignore[arg-type]
    return convolution


class ImageAdapter(nn.Module):
    """An adapter that turns conditioning images into features.

    Args:
        config: channels, width and scales.
        token_px: pixels per token, along a side.
        out: channels of a token.
    """

    def __init__(self, config: AdapterConfig, token_px: int, out: int) -> None:
        super().__init__()
        self.config, self.token_px = config, token_px
        channels, cell_px = config.channels * config.unshuffle**2, config.unshuffle
        blocks = []
        for scale in config.scales:
            # Cells only grow: features of half resolution are not enlarged for the next block.
            blocks.append(_Block(channels, config.width, config.resnets, scale * token_px // cell_px))
            channels, cell_px = config.width, scale * token_px
        self.body = nn.ModuleList(blocks)
        self.zero_convs = nn.ModuleList(_zero_convolution(config.width, out) for _ in config.scales)

    def forward(self, images: Tensor) -> list[Tensor]:
        """Map images (N, channels, height, width) to features (N, rows * columns, out), one for each block."""
        x = pixel_unshuffle(images, self.config.unshuffle)
        size = images.shape[-2] // self.token_px, images.shape[-1] // self.token_px
        features = []
        for block, convolution, scale in zip(self.body, self.zero_convs, self.config.scales):
            x = block(x)
            feature = convolution(x)
            if scale > 1:
                feature = interpolate(feature, size=size, mode="bilinear", align_corners=False)
            features.append(feature.flatten(2).transpose(1, 2))
        return features


def add_features(first: list[Tensor], second: list[Tensor]) -> list[Tensor]:
    """Return the sum of two lists of features; the rest of the longer list is appended unchanged."""
    longer, shorter = (first, second) if len(first) >= len(second) else (second, first)
    return [feature + shorter[place] if place < len(shorter) else feature for place, feature in enumerate(longer)]


def select_frames(features: list[Tensor], shape: tuple[int, int, int], frames: slice) -> list[Tensor]:
    """Return the features of some frames of a sequence.

    Args:
        features: each (B * T * V, L, width).
        shape: B, T and V.
        frames: which of the T frames.
    """
    return [torch.flatten(one.unflatten(0, shape)[:, frames], 0, 2) for one in features]
