"""Runs the networks of a node on its rows."""

from __future__ import annotations

import torch
from torch import Tensor

from hybridworldsim.kernels.dispatch import is_compiled
from hybridworldsim.model.decoders import ModulatedMLP, run_mlps
from hybridworldsim.model.nodes.fused_networks import run_fused
from hybridworldsim.model.nodes.network_inputs import network_inputs


def run_networks(
    codes: Tensor, means: Tensor, eye: Tensor, radius_m: float | None, *networks: tuple[ModulatedMLP, Tensor]
) -> tuple[Tensor, ...]:
    """Apply several networks to the same rows, each under its own appearance.

    Where torch records no gradients, a fused kernel computes the same in less time.

    Args:
        codes: (M, F).
        means: (M, 3) in the block's frame, metres.
        eye: (3,) centre of the camera, in the block's frame, metres.
        radius_m: radius of the block, the unit of the places; None: the networks read no places.
        networks: pairs of a network and an appearance (latent,).

    Returns:
        The output (M, outputs) of each network.
    """
    if torch.is_grad_enabled() or not is_compiled(codes):
        return run_mlps(network_inputs(codes, means, eye, radius_m), *networks)
    return run_fused(codes, means, eye, radius_m, *networks)
