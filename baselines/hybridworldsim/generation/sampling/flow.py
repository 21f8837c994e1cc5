"""Rectified flow: clean latents and noise, mixed along a straight line (P. Esser et al., 2024).

``noisy = (1 - level) * clean + level * noise``; networks predict the velocity ``noise - clean``. The level goes from 0
(clean) to 1 (noise); time steps of networks are ``1000 * level``.
"""

from __future__ import annotations

import math
from typing import Final, Literal, TypeAlias

import torch
from torch import Tensor

from mirror.errors import UsageError

TIMESTEPS: Final = 1000.0
"""Time step of noise alone."""

Weighting: TypeAlias = Literal["velocity", "epsilon", "x0"]
"""The mean square error that is the loss: that of the velocity, of the noise, or of the clean latents."""

_LOGIT_NORMAL: Final = (0.4, 1.0)
_HIGH_NOISE: Final = (1.8, 1.0)
_HIGH_SHARE: Final = 0.3


def add_noise(clean: Tensor, noise: Tensor, level: Tensor) -> Tensor:
    """Return the latents at a noise level.

    Args:
        clean: (..., C, H, W).
        noise: of the same shape.
        level: (...) from 0 to 1.
    """
    share = level[..., None, None, None]
    return (1.0 - share) * clean + share * noise


def to_clean(noisy: Tensor, velocity: Tensor, level: Tensor) -> Tensor:
    """Return the clean latents that a velocity implies; see `add_noise` for the arguments."""
    return noisy - level[..., None, None, None] * velocity


def to_noise(noisy: Tensor, velocity: Tensor, level: Tensor) -> Tensor:
    """Return the noise that a velocity implies; see `add_noise` for the arguments."""
    return noisy + (1.0 - level[..., None, None, None]) * velocity


def loss_weight(level: Tensor, weighting: Weighting) -> Tensor:
    """Return the factor that converts the square error of the velocity to the square error of another quantity.

    Args:
        level: (...) noise levels.
        weighting: the quantity. The paper states its loss for the noise (``epsilon``).

    Returns:
        (...) 1, ``(1 - level)**2`` or ``level**2``.
    """
    if weighting == "velocity":
        return torch.ones_like(level)
    return (1.0 - level) ** 2 if weighting == "epsilon" else level**2


def draw_levels(shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Draw the noise levels for training: 70 % logit-normal (0.4, 1), 30 % higher, logit-normal (1.8, 1).

    Only high levels decide what appears at all, so they are drawn more often than from one logit-normal distribution.
    """
    normal = torch.randn(shape, generator=generator)
    high = torch.rand(shape, generator=generator) < _HIGH_SHARE
    mean = torch.where(high, _HIGH_NOISE[0], _LOGIT_NORMAL[0])
    deviation = torch.where(high, _HIGH_NOISE[1], _LOGIT_NORMAL[1])
    return torch.sigmoid(mean + deviation * normal)


def noise_levels(steps: int, shift: float = 1.0) -> list[float]:
    """Return the noise levels that a sampler visits, with the shift towards noise already applied.

    Args:
        steps: number of steps.
        shift: ``level * shift / (1 + (shift - 1) * level)``; 1 leaves levels equally spaced. Stable Diffusion 3 uses 3.

    Returns:
        ``steps + 1`` levels from 1 to 0.

    Raises:
        UsageError: a number is not above 0.
    """
    if steps < 1 or not (math.isfinite(shift) and shift > 0.0):
        raise UsageError(f"{steps} steps, shift {shift}", expected="at least one step, and a shift above 0")
    levels = [1.0 - place / steps for place in range(steps)]
    return [level * shift / (1.0 + (shift - 1.0) * level) for level in levels] + [0.0]
