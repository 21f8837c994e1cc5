"""What each block of a street contributes beside the others: rows of its nodes, and their weights."""

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
from hybridworldsim.model.splats import DecodedSplats
from hybridworldsim.model.street import StreetModel
from mirror.arrays import Float64
from mirror.devices import CPU
from mirror.errors import UsageError

MIN_WEIGHT: Final = 1.0 / 255.0
"""Weights and opacities below this are treated as zero: one level of an 8-bit colour."""

_MAX_HEIGHT_SHARE: Final = 2.0
_MAX_FAR_SHARE: Final = 0.8
_MIN_SINE: Final = 0.7

LatentSelector: TypeAlias = Callable[[AppearanceLatents], tuple[Tensor, Tensor]]
"""Selects two latents of a block: the appearance of its colours and that of its content."""

_Node = TypeVar("_Node", bound=nn.Module)


@dataclass(frozen=True, eq=False)
class Part:
    """A block of a composed street.

    Attributes:
        block: the block.
        street: its nodes, without rows that are never shown.
        background: (anchors,) weights.
        ground: (Gaussians,) weights.
        stored_count: number of Gaussians before rows were left out.
    """

    block: Block
    street: StreetModel
    background: Tensor
    ground: Tensor
    stored_count: int

    def to(self, device: str) -> Part:
        """Return the part on a device."""
        if device == CPU:
            return self
        return replace(
            self,
            street=self.street.to(device),
            background=self.background.to(device),
            ground=self.ground.to(device),
        )


@dataclass(frozen=True, eq=False)
class Parts:
    """All blocks of a street.

    Attributes:
        parts: one for each block.
        origin_m: (3,) mean of the blocks' origins, in the world.
        centres: (B, 2) float64 centres of the blocks, relative to `origin_m`.
        ramp_m: width of the strips of their partition.
    """

    parts: tuple[Part, ...]
    origin_m: Float64
    centres: Tensor
    ramp_m: float

    def sky_weights(self, eye_m: Float64) -> Tensor:
        """Return the weights (B,) of the blocks' skies for a camera at (3,) in the world."""
        place = torch.from_numpy(np.asarray(eye_m[:2] - self.origin_m[:2])[None])
        return partition(place, self.centres, self.ramp_m)[0]


def split_street(blocks: Sequence[tuple[Block, StreetModel]]) -> Parts:
    """Divide the street among its blocks.

    Anchors and ground Gaussians are weighted by `partition`, and those without weight are left out. Distant structures
    in a block's sky node are left out where another block has its own geometry. The dome behind them stays complete.

    Args:
        blocks: blocks, each with its street in the block's frame.

    Raises:
        UsageError: there is no block, or the blocks differ in size or overlap.
    """
    if not blocks or len({(block.size_m, block.overlap_m) for block, _ in blocks}) != 1:
        raise UsageError(f"{len(blocks)} blocks to compose", expected="at least one, all of one size and overlap")
    origins = np.array([block.origin_m for block, _ in blocks])
    centre = origins.mean(axis=0)
    centres, ramp_m = torch.from_numpy(origins[:, :2] - centre[:2]), blocks[0][0].overlap_m
    parts = []
    for place, (block, street) in enumerate(blocks):
        tables = street.background.means.detach(), street.ground.means.detach()
        weights = [
            partition(table[:, :2].double() + centres[place], centres, ramp_m)[:, place].float() for table in tables
        ]
        weighted_rows = [(weight > MIN_WEIGHT).nonzero().squeeze(1) for weight in weights]
        sky = street.sky.means.detach()
        is_covered = torch.zeros(len(sky), dtype=torch.bool)
        for other, _ in blocks:
            if other is not block:
                is_covered |= _is_inside(other, block, sky)
        kept = ~(is_covered & (sky.norm(dim=1) < _MAX_FAR_SHARE * _dome_radius_m(sky)))
        smaller = StreetModel(
            subset(street.background, weighted_rows[0]),
            subset(street.ground, weighted_rows[1]),
            subset(street.sky, kept.nonzero().squeeze(1)),
            street.appearance,
            street.light,
        )
        stored_count = len(street.background) * street.background.k + len(street.ground) + len(street.sky)
        parts.append(Part(block, smaller, weights[0][weighted_rows[0]], weights[1][weighted_rows[1]], stored_count))
    return Parts(tuple(parts), centre, centres, ramp_m)


def subset(node: _Node, weighted_rows: Tensor) -> _Node:
    """Copy a node with some of its rows; the networks are shared."""
    smaller = copy.copy(node)
    smaller._parameters = {
        name: nn.Parameter(table.detach()[weighted_rows], requires_grad=False) if table is not None else None
        for name, table in node._parameters.items()
    }
    return smaller


def fade(splats: DecodedSplats, weights: Tensor) -> DecodedSplats:
    """Multiply the optical depth of Gaussians by weights (N,)."""
    return replace(splats, opacities=1.0 - (1.0 - splats.opacities).clamp_min(1e-6) ** weights)


def _dome_radius_m(sky: Tensor) -> float:
    """Radius of a block's dome: the median distance of Gaussians high above, where there are no distant structures."""
    away = sky.norm(dim=1)
    above = away[sky[:, 2] > _MIN_SINE * away]
    return float(above.median()) if len(above) else float("inf")


def _is_inside(other: Block, block: Block, means: Tensor) -> Tensor:
    """(N,) whether Gaussians in a block's frame lie where another block has geometry."""
    shift = means.new_tensor(np.array(block.origin_m) - np.array(other.origin_m))
    local = (means + shift).abs()
    return (local[:, :2] <= other.half_extent_m).all(1) & (local[:, 2] <= _MAX_HEIGHT_SHARE * other.half_extent_m)
