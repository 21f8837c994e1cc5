"""Small scenes in front of small cameras, as arguments of `rasterization`."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

BACKENDS = ("reference", "cpu")
both_backends = pytest.mark.parametrize("backend", BACKENDS)
WIDTH, HEIGHT = 37, 21  # no multiples of a tile
FOCAL = 30.0


def cameras(count: int = 1, width: int = WIDTH, height: int = HEIGHT) -> dict[str, Any]:
    """Cameras side by side that look along z, the principal point off centre."""
    viewmats = torch.eye(4).repeat(count, 1, 1)
    viewmats[:, 0, 3] = torch.linspace(0.0, 0.4, count)
    ks = torch.tensor([[FOCAL, 0.0, 0.4375 * width], [0.0, FOCAL + 2.0, 0.5625 * height], [0.0, 0.0, 1.0]])
    return {"viewmats": viewmats, "Ks": ks.repeat(count, 1, 1), "width": width, "height": height}


def gaussians(count: int = 40, seed: int = 0, channels: int = 3) -> dict[str, Tensor]:
    """Gaussians of all shapes; some are beside the image or behind the camera."""
    random = torch.Generator().manual_seed(seed)
    means = torch.randn(count, 3, generator=random) * torch.tensor([2.0, 1.0, 2.0]) + torch.tensor([0.0, 0.0, 4.0])
    return {
        "means": means,
        "quats": torch.randn(count, 4, generator=random),
        "scales": torch.exp(torch.randn(count, 3, generator=random) - 2.0),
        "opacities": torch.rand(count, generator=random),
        "colors": torch.rand(count, channels, generator=random),
    }


def scene(count: int = 40, views: int = 1, seed: int = 0, channels: int = 3) -> dict[str, Any]:
    """Both."""
    return gaussians(count, seed, channels) | cameras(views)


def one(mean: tuple[float, float, float], scale: float, opacity: float, color: tuple[float, ...]) -> dict[str, Tensor]:
    """One round Gaussian."""
    return {
        "means": torch.tensor([mean]),
        "quats": torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        "scales": torch.full((1, 3), scale),
        "opacities": torch.tensor([opacity]),
        "colors": torch.tensor([color]),
    }


def with_gradients(arguments: dict[str, Any], *names: str) -> dict[str, Any]:
    """The same numbers, to be differentiated to."""
    return arguments | {name: arguments[name].detach().clone().requires_grad_() for name in names}


def concatenate(*parts: dict[str, Tensor]) -> dict[str, Tensor]:
    """Gaussians one after the other."""
    return {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
