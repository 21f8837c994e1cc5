"""Renders several blocks as one street: each block shows its own area, and one sky lies behind all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.model.blocks import Block
from hybridworldsim.model.lamps import Lamps, lit_anchors, lit_code_gaussians
from hybridworldsim.model.parts import MIN_WEIGHT, LatentSelector, Part, fade, split_street
from hybridworldsim.model.splats import DecodedSplats
from hybridworldsim.model.street import StreetModel, StreetOutput, render
from hybridworldsim.model.visible import select_visible
from hybridworldsim.trainable.viewpoint import Viewpoint, to_viewpoint
from mirror.arrays import Float64
from mirror.devices import CPU
from mirror.protocols.views.view import RenderView

LampSelector: TypeAlias = Callable[[StreetModel, Viewpoint], Lamps | None]
"""Selects the headlights that light a block for a camera."""


class Composition:
    """Trained blocks, rendered as one street.

    Every anchor and every ground Gaussian is weighted by `partition` at its place. The weight does not depend on the
    camera, so that nothing changes when a camera crosses a boundary. Distant structures in a block's sky node are left
    out where another block has them as geometry. The sky is that of the camera's block, cross-faded by the same
    partition at the camera.

    A weight w turns an opacity a into ``1 - (1 - a) ** w``: two blocks that show the same surface cover what lies
    behind it as one block would.

    Args:
        blocks: blocks, each with its street in the block's frame, on the CPU.
        device: where views are rendered; the streets' networks and latents are moved there.

    Raises:
        UsageError: there is no block, or the blocks differ in size or overlap.
    """

    def __init__(self, blocks: Sequence[tuple[Block, StreetModel]], device: str = CPU) -> None:
        self._split = split_street(blocks)
        self._parts = [_RenderablePart(part.to(device)) for part in self._split.parts]

    def home(self, view: RenderView) -> int:
        """Return the number of the block in which a view's camera is."""
        return int(self._split.sky_weights(view.pose.translation[0]).argmax())

    def render(
        self, view: RenderView, select_latents: LatentSelector, select_lamps: LampSelector | None = None
    ) -> tuple[StreetOutput, Mapping[str, int]]:
        """Render a view.

        Args:
            view: a pinhole view in the world.
            select_latents: selects the latents that a block is rendered with.
            select_lamps: selects the headlights; None: there are none.

        Returns:
            The image; and counts of blocks, of nodes, and of Gaussians that are held, decoded and drawn.

        Raises:
            UsageError: the view's lens is not a pinhole.
        """
        decoded = self.decode(view, select_latents, select_lamps)
        counts = {
            "blocks": len(self._parts),
            "nodes": 3 * len(self._parts),
            "nodes_drawn": len(decoded.splats),
            "held": sum(renderable.part.stored_count for renderable in self._parts),
            "decoded": sum(splats.decoded_count for splats in decoded.splats),
            "drawn": sum(len(splats) for splats in decoded.splats),
        }
        return self.draw(view, decoded), counts

    @torch.inference_mode()
    def decode(
        self, view: RenderView, select_latents: LatentSelector, select_lamps: LampSelector | None = None
    ) -> Decoded:
        """Decode the Gaussians that a view may see; see `render`."""
        sky_weights = self._split.sky_weights(view.pose.translation[0])
        home = self._parts[int(sky_weights.argmax())].part.block
        shown = []
        for renderable, sky in zip(self._parts, sky_weights.tolist()):
            shift = np.array(renderable.part.block.origin_m) - np.array(home.origin_m)
            viewpoint = to_viewpoint(view, np.array(renderable.part.block.origin_m))
            lamps = None if select_lamps is None else select_lamps(renderable.part.street, viewpoint)
            shown += [_translate(splats, shift) for splats in renderable.decode(viewpoint, sky, select_latents, lamps)]
        return Decoded(np.array(home.origin_m), tuple(shown))

    @torch.inference_mode()
    def draw(self, view: RenderView, decoded: Decoded) -> StreetOutput:
        """Draw decoded Gaussians in a view, which may differ from the view that they were decoded for."""
        if not decoded.splats:
            return _empty_render(view)
        return render(to_viewpoint(view, decoded.origin_m), decoded.splats)


@dataclass(frozen=True, eq=False)
class Decoded:
    """Gaussians, of all blocks, that a view may see.

    Attributes:
        origin_m: (3,) origin of their frame in the world.
        splats: the Gaussians of each node.
    """

    origin_m: Float64
    splats: tuple[DecodedSplats, ...]


class _RenderablePart:
    """A part with bounding spheres of its nodes.

    Args:
        part: the part.
    """

    def __init__(self, part: Part) -> None:
        self.part = part
        self._reach_m = [node.reach_m() for node in part.street.nodes]
        means = [node.means for node in part.street.nodes]
        self._bounds = torch.stack([_bounding_sphere(*points) for points in zip(means, self._reach_m)])
        self._is_unweighted = bool((part.background == 1.0).all()), bool((part.ground == 1.0).all())

    def decode(
        self, viewpoint: Viewpoint, sky: float, select_latents: LatentSelector, lamps: Lamps | None
    ) -> list[DecodedSplats]:
        """Decode the nodes that a viewpoint may see; a node outside the view is not decoded."""
        nodes = select_visible(viewpoint, self._bounds[:, :3], self._bounds[:, 3]).tolist()
        background, ground, sky_visible = (node in nodes for node in range(3))
        sky_visible &= sky > MIN_WEIGHT
        if not (background or ground or sky_visible):
            return []
        street, shown = self.part.street, []
        background_reach_m, ground_reach_m, sky_reach_m = self._reach_m
        latent, content = select_latents(street.appearance)
        if background:
            anchors = street.background.visible_ids(viewpoint, background_reach_m)
            anchor_rows = street.background.rows(anchors)
            splats = street.background.decode(viewpoint, latent, content, anchor_rows)
            if lamps is not None:
                splats = lit_anchors(street.background, anchor_rows, splats, viewpoint, lamps)
            weights = None if self._is_unweighted[0] else self.part.background[splats.rows // street.background.k]
            shown.append(splats if weights is None else fade(splats, weights))
        if ground:
            ids = street.ground.visible_ids(viewpoint, ground_reach_m)
            rows = street.ground.rows(ids)
            splats = street.ground.decode(viewpoint, latent, rows)
            if lamps is not None:
                splats = lit_code_gaussians(street.ground, rows, splats, viewpoint, lamps)
            shown.append(splats if self._is_unweighted[1] else fade(splats, self.part.ground[splats.rows]))
        if sky_visible:
            ids = street.sky.visible_ids(viewpoint, sky_reach_m)
            splats = street.sky.decode(viewpoint, latent, street.sky.rows(ids))
            shown.append(splats if sky == 1.0 else fade(splats, splats.opacities.new_full((len(splats),), sky)))
        return shown


def _empty_render(view: RenderView) -> StreetOutput:
    """A black image with no parts, for a view that sees no node."""
    rows, columns = view.height_px, view.width_px
    black, nothing = torch.zeros(rows, columns, 3), torch.zeros(rows, columns)
    return StreetOutput(black, nothing, nothing.clone(), (), {})


def _bounding_sphere(means: Tensor, reach_m: Tensor) -> Tensor:
    """(4,) centre and radius of a sphere that holds all of a node; an empty node gets a radius that no view sees."""
    means = means.detach()
    if not len(means):
        return means.new_tensor((0.0, 0.0, 0.0, -1e9))
    centre = (means.amin(0) + means.amax(0)) / 2.0
    return torch.cat([centre, ((means - centre).norm(dim=1) + reach_m).max()[None]])


def _translate(splats: DecodedSplats, shift_m: Float64) -> DecodedSplats:
    """Translate Gaussians into the frame of another block."""
    if not shift_m.any():
        return splats
    return replace(splats, means=splats.means + splats.means.new_tensor(shift_m))
