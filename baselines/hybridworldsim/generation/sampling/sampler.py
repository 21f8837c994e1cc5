"""The sampler: Euler steps along the velocity of a network, from noise to clean latents."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import TypeAlias

import torch
from torch import Tensor

from mirror.errors import UsageError

Velocity: TypeAlias = Callable[[Tensor, float], Tensor]
"""From latents and their noise level to the velocity."""


def sample(velocity: Velocity, noise: Tensor, levels: Sequence[float]) -> Tensor:
    """Integrate the velocity over the noise levels.

    Args:
        velocity: the network.
        noise: latents at the first level.
        levels: falling noise levels; see `noise_levels`.

    Returns:
        Latents at the last level.

    Raises:
        UsageError: levels do not fall, or lie outside 0 to 1.
    """
    if any(not 1.0 >= before > after >= 0.0 for before, after in itertools.pairwise(levels)) or len(levels) < 2:
        raise UsageError(f"noise levels {list(levels)}", expected="at least two falling levels from 1 to 0")
    latents = noise
    for before, after in itertools.pairwise(levels):
        latents = latents + (after - before) * velocity(latents, before)
    return latents


def guide(conditional: Velocity, unconditional: Velocity, scale: float) -> Velocity:
    """Combine two velocities by classifier-free guidance (J. Ho, T. Salimans, 2022).

    Args:
        conditional: the network with its conditions.
        unconditional: the network without them.
        scale: 1 is the conditional velocity alone.
    """

    def guided(latents: Tensor, level: float) -> Tensor:
        without = unconditional(latents, level)
        return without + scale * (conditional(latents, level) - without)

    return guided


def draw_noise(shape: Sequence[int], seeds: Sequence[int], *, device: torch.device | str = "cpu") -> Tensor:
    """Draw noise that depends on the seeds only, equal on every device.

    Args:
        shape: shape of the result.
        seeds: such as the seed of a run and the number of a frame; at most 64 bits are used of their hash.
        device: where the result is.

    Returns:
        Standard normal numbers, float32.
    """
    import numpy as np

    state = np.random.SeedSequence(list(seeds)).generate_state(1, np.uint64)[0]
    generator = torch.Generator().manual_seed(int(state >> np.uint64(1)))
    return torch.randn(tuple(shape), generator=generator).to(device)
