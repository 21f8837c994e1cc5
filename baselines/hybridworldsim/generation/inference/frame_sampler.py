"""Samples one frame: references once, then the steps of the sampler."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from hybridworldsim.generation.devices import Precision, computing_in
from hybridworldsim.generation.inference.sliding_cache import SlidingCache
from hybridworldsim.generation.network.adapter import add_features
from hybridworldsim.generation.network.conditions import Conditions, PreparedConditions, ReferenceCache
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.sampling.flow import TIMESTEPS, add_noise, noise_levels
from hybridworldsim.generation.sampling.sampler import Velocity, guide, sample
from mirror.errors import UsageError


@dataclass(frozen=True)
class SamplerSettings:
    """Settings of sampling a frame.

    Attributes:
        steps: number of steps.
        shift: shift of the noise levels; see `noise_levels`.
        guidance: scale of classifier-free guidance; 1: none. Above, a frame is pushed away from what the network would
            generate without layout, which doubles the passes; the network must have been trained with `drop_layout`.
        context_noise: noise level of the references, which hides errors that add up over a rollout; the network gets
            the level. 0: the references are used as they are.
        cache: whether a causal network encodes the references once for all steps.
        refresh_every: 1: all references are encoded for each frame, which is exact. Above: a rollout keeps their
            keys and values for as many frames, and encodes only the newest reference of each frame between; see
            `SlidingCache`.
        precision: ``bf16``: the network computes in bfloat16; latents stay as they are.
    """

    steps: int = 4
    shift: float = 1.0
    guidance: float = 1.0
    context_noise: float = 0.0
    cache: bool = True
    refresh_every: int = 1
    precision: Precision = "float32"

    def __post_init__(self) -> None:
        if not 0.0 <= self.context_noise < 1.0:
            raise UsageError(f"context_noise {self.context_noise}", expected="from 0 to below 1")
        if not (math.isfinite(self.guidance) and self.guidance >= 0.0):
            raise UsageError(f"guidance {self.guidance}", expected="a finite number, 0 or above")
        if self.refresh_every < 1 or (self.refresh_every > 1 and not (self.cache and self.guidance == 1.0)):
            raise UsageError(
                f"refresh_every {self.refresh_every}",
                expected="at least 1; above 1 with the cache, and without guidance",
            )
        noise_levels(self.steps, self.shift)


def target_velocity(
    network: Transformer,
    references: Tensor,
    prepared: PreparedConditions,
    *,
    reference_level: float = 0.0,
    cache: bool = True,
    sliding: SlidingCache | None = None,
) -> Velocity:
    """Return the velocity of a target frame, given its references.

    Args:
        network: the network.
        references: (B, T, V, C, H, W) latents, at the noise level ``reference_level``.
        prepared: conditions of the window, from `join_conditions`.
        reference_level: noise level of the references.
        cache: whether a causal network encodes the references once.
        sliding: keeps keys and values of the references from frame to frame; None: all are computed here.

    Returns:
        From latents (B, 1, V, C, H, W) and their noise level to the velocity.
    """
    batch, count, views = references.shape[:3]
    reference_steps = torch.full((batch, count, views), TIMESTEPS * reference_level).to(references)
    in_channels = bool(network.config.reference_channels)
    held: ReferenceCache | None = None
    if network.config.causal and cache and not in_channels:
        encode = network.encode_references if sliding is None else partial(sliding.encode, network)
        held = encode(references, reference_steps, prepared.frames(slice(0, count)))
        prepared = prepared.frames(slice(count, count + 1))

    def velocity(latents: Tensor, level: float) -> Tensor:
        steps = torch.full((batch, 1, views), TIMESTEPS * level).to(latents)
        if in_channels:
            stacked = torch.cat([latents, references.transpose(1, 2).flatten(2, 3)[:, None]], dim=3)
            return network(stacked, steps, prepared, reference_timestep=reference_steps[:, :1])
        if held is not None:
            return network(latents, steps, prepared, held)
        window = torch.cat([references, latents], dim=1)
        return network(window, torch.cat([reference_steps, steps], dim=1), prepared)[:, count:]

    return velocity


def sample_frame(
    network: Transformer,
    references: Tensor,
    conditions: Conditions,
    noise: Tensor,
    settings: SamplerSettings,
    *,
    features: list[Tensor] | None = None,
    context_noise: Tensor | None = None,
    unconditional: Conditions | None = None,
    unconditional_features: list[Tensor] | None = None,
    sliding: SlidingCache | None = None,
) -> Tensor:
    """Sample the latents of one frame.

    Args:
        network: the network.
        references: (B, T, V, C, H, W) clean latents.
        conditions: of the window, from `join_conditions`.
        noise: (B, 1, V, C, H, W) standard normal numbers.
        settings: see `SamplerSettings`.
        features: the adapters' features of the window; None: they are computed.
        context_noise: (B, T, V, C, H, W) standard normal numbers, for `SamplerSettings.context_noise`.
        unconditional: the same conditions without layout, for guidance.
        unconditional_features: the adapters' features of them; None: they are computed.
        sliding: as in `target_velocity`.

    Returns:
        (B, 1, V, C, H, W).

    Raises:
        UsageError: guidance without `unconditional`, or a context noise level without its noise.
    """
    level = settings.context_noise
    if level > 0.0:
        if context_noise is None:
            raise UsageError("a level of context noise without noise", expected="context_noise")
        share = torch.full(references.shape[:3], level).to(references)
        references = add_noise(references, context_noise.to(references), share)
    guided = settings.guidance != 1.0
    if guided and unconditional is None:
        raise UsageError(f"guidance {settings.guidance}", expected="conditions of the unconditional velocity")
    with computing_in(settings.precision, references.device):
        if guided and unconditional is not None and unconditional_features is None:
            # The background is the same in both passes.
            background = network.encode_background(conditions)
            unconditional_features = add_features(network.encode_layout(unconditional), background)
            if features is None:
                features = add_features(network.encode_layout(conditions), background)
        velocity = target_velocity(
            network, references, network.prepare(conditions, features), reference_level=level, cache=settings.cache,
            sliding=sliding,
        )  # fmt: skip
        if guided and unconditional is not None:
            without = target_velocity(
                network, references, network.prepare(unconditional, unconditional_features), reference_level=level,
                cache=settings.cache,
            )  # fmt: skip
            velocity = guide(velocity, without, settings.guidance)
        return sample(velocity, noise, noise_levels(settings.steps, settings.shift))
