"""What each block of a street shows beside the others: which rows of its nodes, and with what weights."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.blocks import Block
from hybridworldsim.model.partition import partition
from hybridworldsim.model.splats import Splats
from hybridworldsim.model.street import Street
from mirror.arrays import Float64
from mirror.errors import UsageError

LEAST: Final = 1.0 / 255.0
"""Weights and opacities below are nothing."""

_TALLEST: Final = 2.0
_INSIDE: Final = 0.8
_STEEP: Final = 0.7

LatentSelector: TypeAlias = Callable[[AppearanceLatents], tuple[Tensor, Tensor]]
"""Of a block's latents, the appearance of its colours and of what is there."""

_Node = TypeVar("_Node", bound=nn.Module)


@dataclass(frozen=True, eq=False)
class Part:
    """A block as it is shown among others.

    Attributes:
        block: where it is.
        street: its nodes, without the rows that are never shown.
        background: (anchors,) weights.
        ground: (Gaussians,) weights.
        stored_count: Gaussians before any were left out.
    """

    block: Block
    street: Street
    background: Tensor
    ground: Tensor
    stored_count: int


@dataclass(frozen=True, eq=False)
class Parts:
    """All blocks of a street.

    Attributes:
        parts: one a block.
        origin_m: (3,) mean of the blocks' origins, in the world.
        centres: (B, 2) float64 of the blocks, from there.
        ramp_m: of their partition.
    """

    parts: tuple[Part, ...]
    origin_m: Float64
    centres: Tensor
    ramp_m: float

    def sky_weights(self, eye_m: Float64) -> Tensor:
        """(B,) weights of the blocks' skies for a camera (3,) in the world."""
        place = torch.from_numpy(np.asarray(eye_m[:2] - self.origin_m[:2])[None])
        return partition(place, self.centres, self.ramp_m)[0]


def split_street(blocks: Sequence[tuple[Block, Street]]) -> Parts:
    """Divide the street among its blocks.

    Anchors and the ground's Gaussians are weighted by `partition`, those without weight left out; so are far structures
    in a block's sky that stand where another block has geometry of its own. The dome behind them stays whole.

    Args:
        blocks: with the street of each, in its frame.

    Raises:
        UsageError: there is none, or they are not of one size.
    """
    if not blocks or len({(block.size_m, block.overlap_m) for block, _ in blocks}) != 1:
        raise UsageError(f"{len(blocks)} blocks to compose", expected="at least one, all of one size and overlap")
    origins = np.array([block.origin_m for block, _ in blocks])
    centre = origins.mean(axis=0)
    centres, ramp_m = torch.from_numpy(origins[:, :2] - centre[:2]), blocks[0][0].overlap_m
    parts = []
    for place, (block, street) in enumerate(blocks):
        tables = street.background.means.detach(), street.ground.means.detach()
        own = [partition(table[:, :2].double() + centres[place], centres, ramp_m)[:, place].float() for table in tables]
        rows = [(weight > LEAST).nonzero().squeeze(1) for weight in own]
        sky = street.sky.means.detach()
        elsewhere = torch.zeros(len(sky), dtype=torch.bool)
        for other, _ in blocks:
            if other is not block:
                elsewhere |= _within(other, block, sky)
        kept = ~(elsewhere & (sky.norm(dim=1) < _INSIDE * _dome_m(sky)))
        smaller = Street(
            subset(street.background, rows[0]),
            subset(street.ground, rows[1]),
            subset(street.sky, kept.nonzero().squeeze(1)),
            street.appearance,
        )
        held = len(street.background) * street.background.k + len(street.ground) + len(street.sky)
        parts.append(Part(block, smaller, own[0][rows[0]], own[1][rows[1]], held))
    return Parts(tuple(parts), centre, centres, ramp_m)


def subset(node: _Node, rows: Tensor) -> _Node:
    """A node with some of its rows alone; the networks are shared."""
    smaller = copy.copy(node)
    smaller._parameters = {
        name: nn.Parameter(table.detach()[rows], requires_grad=False) if table is not None else None
        for name, table in node._parameters.items()
    }
    return smaller


def fade(splats: Splats, weights: Tensor) -> Splats:
    """Gaussians whose optical depth is multiplied by weights (N,)."""
    return replace(splats, opacities=1.0 - (1.0 - splats.opacities).clamp_min(1e-6) ** weights)


def _dome_m(sky: Tensor) -> float:
    """Radius of a block's dome: how far away is what stands steeply above, where no far structure reaches."""
    away = sky.norm(dim=1)
    above = away[sky[:, 2] > _STEEP * away]
    return float(above.median()) if len(above) else float("inf")


def _within(other: Block, block: Block, means: Tensor) -> Tensor:
    """(N,) which Gaussians of a block's frame stand where another block has geometry."""
    shift = means.new_tensor(np.array(block.origin_m) - np.array(other.origin_m))
    local = (means + shift).abs()
    return (local[:, :2] <= other.half_extent_m).all(1) & (local[:, 2] <= _TALLEST * other.half_extent_m)
