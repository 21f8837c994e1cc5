"""Several blocks drawn as one street: each shows what is in its place, and one sky is behind it all."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from hybridworldsim.rendering.partition import partition
from hybridworldsim.rendering.prepared import PreparedStreet
from hybridworldsim.scene.appearance import Appearance
from hybridworldsim.scene.blocks import Block
from hybridworldsim.scene.splats import Splats
from hybridworldsim.scene.street import Drawn, Street, draw
from hybridworldsim.scene.visible import visible
from hybridworldsim.training.viewpoint import Viewpoint, viewpoint_of
from mirror.errors import UsageError
from mirror.evaluation.views.view import View

_LEAST: Final = 1.0 / 255.0
_TALLEST: Final = 2.0

Looks: TypeAlias = Callable[[Appearance], tuple[Tensor, Tensor]]
"""Of a block's latents, the appearance of its colours and of what is there."""

_Node = TypeVar("_Node", bound=nn.Module)


@dataclass(frozen=True, eq=False)
class _Part:
    """A block as it is drawn among others.

    Attributes:
        block: where it is.
        street: its nodes, without the rows that are never drawn.
        background: (anchors,) weights.
        ground: (Gaussians,) weights.
        spheres: of background, ground and sky, (4,): centre and radius of all that they hold.
        held: Gaussians before any were left out.
    """

    block: Block
    street: PreparedStreet
    background: Tensor
    ground: Tensor
    spheres: tuple[Tensor, ...]
    held: int


class Composition:
    """Trained blocks as one street.

    Every anchor and every Gaussian of the ground is weighted by `partition` at its place. That weight does not depend
    on the camera: whoever drives across a boundary sees nothing change. Far structures that a block's sky took in are
    left out where another block has them as geometry. The sky is that of the block that the camera is in, cross-faded
    by the same partition at the camera.

    A weight w makes an opacity a into ``1 - (1 - a) ** w``: two blocks that show the same surface cover what is behind
    it as one would.

    Args:
        blocks: with the street of each, in its frame.

    Raises:
        UsageError: there is none, or they are not of one size.
    """

    def __init__(self, blocks: Sequence[tuple[Block, Street]]) -> None:
        if not blocks or len({(block.size_m, block.overlap_m) for block, _ in blocks}) != 1:
            raise UsageError(f"{len(blocks)} blocks to compose", expected="at least one, all of one size and overlap")
        self._origin = np.mean([block.origin_m for block, _ in blocks], axis=0)
        self._centres = torch.tensor(np.array([block.origin_m for block, _ in blocks])[:, :2] - self._origin[:2])
        self._ramp_m = blocks[0][0].overlap_m
        self._parts = tuple(self._part(place, [block for block, _ in blocks], blocks[place][1])
                            for place in range(len(blocks)))  # fmt: skip

    @torch.inference_mode()
    def draw(self, view: View, looks: Looks) -> tuple[Drawn, Mapping[str, int]]:
        """Draw a view.

        Args:
            view: in the world; a pinhole.
            looks: the appearance that each block is drawn with.

        Returns:
            The picture, and counts: of blocks, nodes and Gaussians held, decoded and drawn.
        """
        place = torch.from_numpy(view.pose.translation[:, :2] - self._origin[:2])
        skies = partition(place, self._centres, self._ramp_m)[0]
        home = self._parts[int(skies.argmax())].block
        shown = [
            _moved(splats, part.block, home)
            for part, sky in zip(self._parts, skies)
            for splats in self._decoded(part, viewpoint_of(view, np.array(part.block.origin_m)), float(sky), looks)
        ]
        drawn = draw(viewpoint_of(view, np.array(home.origin_m)), tuple(shown))
        counts = {
            "blocks": len(self._parts),
            "nodes": 3 * len(self._parts),
            "nodes_drawn": len(shown),
            "held": sum(part.held for part in self._parts),
            "decoded": sum(splats.decoded for splats in shown),
            "drawn": sum(len(splats) for splats in shown),
        }
        return drawn, counts

    def _part(self, place: int, blocks: list[Block], street: Street) -> _Part:
        """A block without what it never shows beside the others."""
        block = blocks[place]

        def own(means: Tensor) -> Tensor:
            shift = torch.tensor(np.array(block.origin_m)[:2] - self._origin[:2])
            return partition(means[:, :2].double() + shift, self._centres, self._ramp_m)[:, place].to(means.dtype)

        sky = street.sky.means.detach()
        kept = torch.ones(len(sky), dtype=torch.bool)
        for other in blocks:
            if other.index != block.index:
                kept &= ~_within(other, block, sky)
        weights = own(street.background.means.detach()), own(street.ground.means.detach())
        rows = [(weight > _LEAST).nonzero().squeeze(1) for weight in weights]
        smaller = Street(
            subset(street.background, rows[0]),
            subset(street.ground, rows[1]),
            subset(street.sky, kept.nonzero().squeeze(1)),
            street.appearance,
        )
        held = len(street.background) * street.background.k + len(street.ground) + len(street.sky)
        nodes = (smaller.background, smaller.ground, smaller.sky)
        spheres = tuple(_sphere(node.means.detach(), node.log_scales.detach()) for node in nodes)
        shares = weights[0][rows[0]], weights[1][rows[1]]
        return _Part(block, PreparedStreet(smaller), *shares, spheres, held)

    def _decoded(self, part: _Part, viewpoint: Viewpoint, sky: float, looks: Looks) -> list[Splats]:
        """What the nodes of a block show that a viewpoint may see."""
        seen = [len(visible(viewpoint, sphere[None, :3], sphere[3:])) > 0 for sphere in part.spheres]
        seen[2] = seen[2] and sky > _LEAST
        if not any(seen):
            return []
        street = part.street
        latent, content = looks(street.appearance)
        shown = []
        if seen[0]:
            splats = street.background.decode(viewpoint, latent, content)
            shown.append(faded(splats, part.background[splats.rows // street.background.k]))
        if seen[1]:
            splats = street.ground.decode(viewpoint, latent)
            shown.append(faded(splats, part.ground[splats.rows]))
        if seen[2]:
            splats = street.sky.decode(viewpoint, latent)
            shown.append(faded(splats, splats.opacities.new_full((len(splats),), sky)))
        return shown


def faded(splats: Splats, weights: Tensor) -> Splats:
    """Gaussians whose optical depth is multiplied by weights (N,)."""
    return replace(splats, opacities=1.0 - (1.0 - splats.opacities).clamp_min(1e-6) ** weights)


def subset(node: _Node, rows: Tensor) -> _Node:
    """A node with some of its rows alone; the networks are shared."""
    smaller = copy.copy(node)
    smaller._parameters = {
        name: nn.Parameter(table.detach()[rows], requires_grad=False) if table is not None else None
        for name, table in node._parameters.items()
    }
    return smaller


def _within(other: Block, block: Block, means: Tensor) -> Tensor:
    """(N,) which Gaussians of a block's frame stand where another block has geometry."""
    shift = means.new_tensor(np.array(block.origin_m) - np.array(other.origin_m))
    local = (means + shift).abs()
    return (local[:, :2] <= other.near_m).all(1) & (local[:, 2] <= _TALLEST * other.near_m)


def _sphere(means: Tensor, log_scales: Tensor) -> Tensor:
    """(4,) centre and radius of a sphere that holds all of a node; of an empty one, a radius that nothing sees."""
    if not len(means):
        return means.new_tensor((0.0, 0.0, 0.0, -1e9))
    reach = 3.0 * log_scales.amax(1).exp()
    centre = (means.amin(0) + means.amax(0)) / 2.0
    return torch.cat([centre, ((means - centre).norm(dim=1) + reach).max()[None]])


def _moved(splats: Splats, block: Block, home: Block) -> Splats:
    """Gaussians of a block's frame in another's."""
    if block is home:
        return splats
    shift = splats.means.new_tensor(np.array(block.origin_m) - np.array(home.origin_m))
    return replace(splats, means=splats.means + shift)
