"""A small convolutional autoencoder for images of a hundred pixels, trained in minutes on one core."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import silu

from mirror.errors import UsageError


@dataclass(frozen=True)
class TinySettings:
    """The settings of a `TinyAutoencoder`.

    Attributes:
        channels: channels of the latents.
        width: channels of the convolutions.
        halvings: how often resolution is halved.
        residuals: residual units behind each halving, and before each doubling.
    """

    channels: int = 8
    width: int = 48
    halvings: int = 2
    residuals: int = 1

    def __post_init__(self) -> None:
        if min(self.channels, self.width, self.halvings) < 1 or self.residuals < 0:
            raise UsageError(f"{self}", expected="channels, width and halvings of at least 1")


class _Residual(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = (nn.Conv2d(width, width, 3, padding=1) for _ in range(2))

    def forward(self, x: Tensor) -> Tensor:
        return x + self.second(silu(self.first(silu(x))))


class TinyAutoencoder(nn.Module):
    """Encoder and decoder. Latents are normalised by channel with statistics that `set_statistics` stores.

    Args:
        settings: its size.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, settings: TinySettings) -> None:
        super().__init__()
        self.settings = settings
        self.channels, self.stride = settings.channels, 2**settings.halvings
        width = settings.width
        # Whole blocks of pixels become channels first: no convolution runs at full resolution.
        down: list[nn.Module] = [nn.PixelUnshuffle(2), nn.Conv2d(12, width, 3, padding=1)]
        up: list[nn.Module] = [nn.Conv2d(settings.channels, width, 3, padding=1)]
        for halving in range(settings.halvings):
            if halving:
                down.append(nn.Conv2d(width, width, 4, stride=2, padding=1))
            down += [_Residual(width) for _ in range(settings.residuals)]
            up += [_Residual(width) for _ in range(settings.residuals)]
            if halving < settings.halvings - 1:
                up += [nn.Conv2d(width, 4 * width, 1), nn.PixelShuffle(2)]
        self.encoder = nn.Sequential(*down, nn.SiLU(), nn.Conv2d(width, settings.channels, 3, padding=1))
        self.decoder = nn.Sequential(*up, nn.SiLU(), nn.Conv2d(width, 12, 3, padding=1), nn.PixelShuffle(2))
        self.register_buffer("mean", torch.zeros(settings.channels))
        self.register_buffer("deviation", torch.ones(settings.channels))

    def encode(self, images: Tensor) -> Tensor:
        """Map images (N, 3, height, width) from 0 to 1 to normalised latents.

        Raises:
            UsageError: the images have another number of channels, or sides that are no multiples of the stride.
        """
        if images.shape[-3] != 3 or images.shape[-2] % self.stride or images.shape[-1] % self.stride:
            raise UsageError(
                f"images of shape {tuple(images.shape)}",
                expected=f"3 channels, sides that are multiples of {self.stride}",
            )
        return (self.encoder(images - 0.5) - self.mean[:, None, None]) / self.deviation[:, None, None]

    def decode(self, latents: Tensor) -> Tensor:
        """Map normalised latents to images (N, 3, height, width).

        Raises:
            UsageError: the latents have another number of channels.
        """
        if latents.shape[-3] != self.channels:
            raise UsageError(f"latents of {latents.shape[-3]} channels", expected=f"{self.channels} channels")
        return self.decoder(latents * self.deviation[:, None, None] + self.mean[:, None, None]) + 0.5

    @torch.no_grad()
    def set_statistics(self, latents: Tensor) -> None:
        """Change the normalisation so that the given latents (N, channels, H, W) have mean 0 and deviation 1.

        Raises:
            UsageError: a channel is constant.
        """
        mean, deviation = latents.mean(dim=(0, 2, 3)), latents.std(dim=(0, 2, 3))
        if not bool((deviation > 0.0).all()):
            raise UsageError("a channel of the latents is constant", expected="images that differ")
        self.mean.add_(self.deviation * mean)
        self.deviation.mul_(deviation)
