"""Configurations, conditions and seeds of rollouts."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.configuration import AdapterConfig
from tests.generation.builders import SHORT, make_conditions

T = 3
AS_CHANNELS = replace(
    SHORT, latent_channels=4, reference_channels=4 * T, temporal_layers=(), causal=False, camera="explicit",
    layout=AdapterConfig(2 * (T + 1), 8, scales=(1, 1)),
)  # fmt: skip
AS_FRAMES = replace(SHORT, latent_channels=4, camera="explicit", layout=AdapterConfig(2, 8, scales=(1, 1)))


def single_frames(count: int, seed: int = 1) -> list[Conditions]:
    """Conditions of single frames; layouts have two channels."""
    config = replace(AS_FRAMES)
    return [make_conditions(config, frames=1, views=2, seed=seed + place) for place in range(count)]


def seeds() -> Tensor:
    return torch.randn((1, T, 2, 4, 4, 6), dtype=torch.float64, generator=torch.Generator().manual_seed(9))
