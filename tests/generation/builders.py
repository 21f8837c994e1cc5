"""Small networks and conditions for the tests of generation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.configuration import CTSD_35, UNIMLVG, AdapterConfig, TransformerConfig
from hybridworldsim.generation.network.transformer import Transformer
from tests.generation.ctsd35_keys import keys, unimlvg_keys

SMALL = replace(
    CTSD_35,
    heads=2,
    head_channels=4,
    text_channels=6,
    pooled_channels=5,
    grid=8,
    grid_base=2,
    layout=AdapterConfig(6, 8),
)
"""The released model with all its blocks, eight channels wide."""

SMALL_UNIMLVG = replace(
    UNIMLVG, heads=2, head_channels=4, text_channels=6, pooled_channels=5, grid=8, grid_base=2,
    layout=AdapterConfig(6, 8),
)  # fmt: skip

SHORT = replace(
    SMALL, layers=4, dual_layers=(0, 1), temporal_layers=(1, 3), cross_view_layers=(0, 2),
    layout=AdapterConfig(6, 8, scales=(1, 1)), causal=True, background=AdapterConfig(3, 4, scales=(1, 2)),
)  # fmt: skip
"""Four blocks of it, causal, with a background adapter."""


def released_checkpoint(path: Path, base: str = "ctsd-35", dtype: torch.dtype = torch.float64) -> dict[str, Tensor]:
    """Write a file with the released names of a base, eight channels wide; returns its tensors."""
    generator = torch.Generator().manual_seed(0)
    shapes = {"ctsd-35": keys, "unimlvg": unimlvg_keys}[base](w=8, h=4, text=6, pooled=5, grid=8)
    state = {name: 0.3 * torch.randn(shape, generator=generator, dtype=dtype) for name, shape in shapes.items()}
    torch.save(state, path)
    return state


def make_network(config: TransformerConfig, seed: int = 0) -> Transformer:
    """A network in float64 whose parameters are all random, so that no term is zero."""
    torch.manual_seed(seed)
    network = Transformer(config).double()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(0.3 * torch.randn_like(parameter))
    return network.requires_grad_(False)


def make_conditions(
    config: TransformerConfig,
    frames: int,
    views: int,
    *,
    rows: int = 2,
    columns: int = 3,
    batch: int = 1,
    seed: int = 1,
) -> Conditions:
    """Random conditions: cameras, text of two tokens, layout and background where the network has adapters."""
    generator = torch.Generator().manual_seed(seed)

    def random(*shape: int) -> Tensor:
        return torch.randn(shape, generator=generator, dtype=torch.float64)

    shape = batch, frames, views
    lens = torch.eye(3, dtype=torch.float64).repeat(*shape, 1, 1)
    lens[..., 0, 0], lens[..., 1, 1] = 0.7 + 0.1 * random(*shape), 1.1 + 0.1 * random(*shape)
    lens[..., :2, 2] = 0.5 + 0.02 * random(*shape, 2)
    size = rows * config.token_px, columns * config.token_px
    return Conditions(
        size,
        lens,
        rigid(random, *shape),
        rigid(random, batch, frames),
        torch.full((batch,), 10.0, dtype=torch.float64),
        random(*shape, 2, config.text_channels),
        random(*shape, config.pooled_channels),
        None if config.layout is None else random(*shape, config.layout.channels, *size),
        None if config.background is None else random(*shape, config.background.channels, *size),
    )


def rigid(random: object, *shape: int) -> Tensor:
    """Random rigid motions (..., 4, 4)."""
    turn = torch.linalg.qr(random(*shape, 3, 3)).Q  # type: ignore[operator]
    turn = turn * torch.linalg.det(turn)[..., None, None]
    motion = torch.eye(4, dtype=torch.float64).repeat(*shape, 1, 1)
    motion[..., :3, :3], motion[..., :3, 3] = turn, random(*shape, 3)  # type: ignore[operator]
    return motion


def make_latents(config: TransformerConfig, conditions: Conditions, seed: int = 2) -> tuple[Tensor, Tensor]:
    """Random latents and a time step for each view of each frame."""
    generator = torch.Generator().manual_seed(seed)
    rows, columns = (side // config.latent_stride for side in conditions.size_px)
    channels = config.latent_channels + config.reference_channels
    latents = torch.randn((*conditions.shape, channels, rows, columns), generator=generator, dtype=torch.float64)
    return latents, 1000.0 * torch.rand(conditions.shape, generator=generator, dtype=torch.float64)
