"""What the generator needs of an autoencoder."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from mirror.arrays import UInt8


class LatentCodec(Protocol):
    """A codec that maps images to latents and back; latents have mean 0 and deviation 1, approximately.

    Attributes:
        channels: channels of the latents.
        stride: pixels per latent, along a side.
    """

    channels: int
    stride: int

    def encode(self, images: Tensor) -> Tensor:
        """Map images (N, 3, height, width) from 0 to 1 to latents (N, channels, height / stride, width / stride)."""
        ...

    def decode(self, latents: Tensor) -> Tensor:
        """Map latents to images; values may lie slightly outside 0 to 1."""
        ...


def to_tensor(images: UInt8) -> Tensor:
    """Map images (..., height, width, 3), 8 bits, to (..., 3, height, width) from 0 to 1, float32."""
    return from_levels(torch.from_numpy(images))


def from_levels(images: Tensor) -> Tensor:
    """Map images (..., height, width, 3), uint8, to (..., 3, height, width) from 0 to 1, on their device."""
    return images.movedim(-1, -3).float() / 255.0


def to_levels(images: Tensor) -> Tensor:
    """Map images (..., 3, height, width) from 0 to 1 to (..., height, width, 3), uint8, on their device."""
    return (images.clamp(0.0, 1.0) * 255.0).round().to(torch.uint8).movedim(-3, -1)


def to_bytes(images: Tensor) -> UInt8:
    """Map images (..., 3, height, width) from 0 to 1 to (..., height, width, 3), 8 bits."""
    rounded: UInt8 = to_levels(images).cpu().numpy()
    return rounded
