"""Decoding of a street's nodes in plain torch: slow, differentiable, in the precision of the street."""

from __future__ import annotations

import copy

import torch
from torch import Tensor
from torch.nn import functional

from hybridworldsim.model.decoders import ModulatedMLP
from hybridworldsim.model.nodes.anchors import Anchors
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians
from hybridworldsim.model.splats import DecodedSplats
from hybridworldsim.model.street import StreetModel, StreetOutput, render
from hybridworldsim.trainable.viewpoint import Viewpoint


def run_mlp(network: ModulatedMLP, codes: Tensor, beside: Tensor, latent: Tensor) -> Tensor:
    """Apply a network to codes (N, code) with their other inputs, under an appearance: (N, outputs)."""
    matrix: Tensor = network.own
    if network.bend is not None:
        bend = (network.bend @ latent).view(-1, network.code)
        matrix = torch.cat((matrix[:, : network.code] + bend, matrix[:, network.code :]), dim=1)
    hidden = torch.cat((codes, beside), dim=1) @ matrix.T + network.bias + network.shared @ latent
    found: Tensor = hidden.relu() @ network.out.weight.T + network.out.bias
    return found


def plain_anchors(node: Anchors, rows: Tensor, eye: Tensor, latent: Tensor, content: Tensor) -> tuple[Tensor, ...]:
    """Return the means, quats, scales, opacities and colours of the Gaussians of anchors (M,)."""
    means, sizes = node.means[rows], node.log_scales[rows].exp()
    beside = torch.cat((functional.normalize(means - eye, dim=1), means / node.radius_m), dim=1)
    numbers = run_mlp(node.geometry, node.codes[rows], beside, content).view(-1, 8)
    tints = run_mlp(node.colour, node.codes[rows], beside, latent).view(-1, 3)
    output = (numbers[:, 0] > 0.0).nonzero().squeeze(1)
    own, parents = numbers[output], output // node.k
    offsets = node.offsets[rows].view(-1, 3)[output]
    return (
        means[parents] + offsets * sizes[parents, :3],
        own[:, 4:],
        sizes[parents, 3:] * own[:, 1:4].sigmoid(),
        own[:, 0].tanh(),
        tints[output].sigmoid(),
    )


def plain_gaussians(node: CodeGaussians, rows: Tensor, eye: Tensor, latent: Tensor) -> tuple[Tensor, ...]:
    """Return the means, quats, scales, opacities and colours of Code-Gaussians (M,)."""
    means = node.means[rows]
    directions = functional.normalize(means.detach() - eye, dim=1)
    return (
        means,
        node.quats[rows],
        node.log_scales[rows].exp(),
        node.logits[rows].sigmoid(),
        run_mlp(node.colour, node.codes[rows], directions, latent).sigmoid(),
    )


@torch.inference_mode()
def to_float64(street: StreetModel) -> StreetModel:
    """Copy a street to float64."""
    return copy.deepcopy(street).double()


@torch.inference_mode()
def plain_image(street: StreetModel, output: StreetOutput, view: Viewpoint, latent: Tensor) -> Tensor:
    """Render (H, W, 3) of a street in float64: decoded here, rasterized by the CPU backend.

    Args:
        street: result of `to_float64`.
        output: a render of the same view of the original street; its rows are decoded.
        view: the camera.
        latent: appearance.
    """
    eye, latent = view.centre.double(), latent.double()
    background, ground, sky = output.parts
    seen = background.rows[:0] if background.anchor_ids is None else background.anchor_ids
    tables = [
        plain_anchors(street.background, seen, eye, latent, latent),
        plain_gaussians(street.ground, ground.rows, eye, latent),
        plain_gaussians(street.sky, sky.rows, eye, latent),
    ]
    return render(view, tuple(map(_splats, tables))).rgb


def _splats(tables: tuple[Tensor, ...]) -> DecodedSplats:
    means, quats, scales, opacities, colours = (table.float() for table in tables)
    count = len(means)
    return DecodedSplats(means, quats, scales, opacities, colours, torch.arange(count), count, count)
