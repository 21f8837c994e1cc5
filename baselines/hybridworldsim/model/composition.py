"""Several blocks drawn as one street: each shows what is in its place, and one sky is behind it all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.model.blocks import Block
from hybridworldsim.model.parts import LEAST, LatentSelector, Part, fade, split_street
from hybridworldsim.model.splats import Splats
from hybridworldsim.model.street import RenderOutput, Street, render
from hybridworldsim.model.visible import select_visible
from hybridworldsim.training.viewpoint import Viewpoint, to_viewpoint
from mirror.arrays import Float64
from mirror.protocols.views.view import RenderView


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
        self._all = split_street(blocks)
        self._ready = [_Ready(part) for part in self._all.parts]

    @torch.inference_mode()
    def render(self, view: RenderView, looks: LatentSelector) -> tuple[RenderOutput, Mapping[str, int]]:
        """Draw a view.

        Args:
            view: in the world; a pinhole.
            looks: the appearance that each block is drawn with.

        Returns:
            The image, and counts: of blocks, nodes and Gaussians held, decoded and drawn.

        Raises:
            UsageError: the view's lens is not a pinhole.
        """
        sky_weights = self._all.sky_weights(view.pose.translation[0])
        home = self._ready[int(sky_weights.argmax())].part.block
        shown = []
        for ready, sky in zip(self._ready, sky_weights.tolist()):
            shift = np.array(ready.part.block.origin_m) - np.array(home.origin_m)
            viewpoint = to_viewpoint(view, np.array(ready.part.block.origin_m))
            shown += [_moved(splats, shift) for splats in ready.decode(viewpoint, sky, looks)]
        drawn = render(to_viewpoint(view, np.array(home.origin_m)), tuple(shown)) if shown else _nothing(view)
        counts = {
            "blocks": len(self._ready),
            "nodes": 3 * len(self._ready),
            "nodes_drawn": len(shown),
            "held": sum(ready.part.stored_count for ready in self._ready),
            "decoded": sum(splats.decoded_count for splats in shown),
            "drawn": sum(len(splats) for splats in shown),
        }
        return drawn, counts


class _Ready:
    """A part, ready to be decoded.

    Args:
        part: which.
    """

    def __init__(self, part: Part) -> None:
        self.part = part
        nodes = part.street.background, part.street.ground, part.street.sky
        self._spheres = [_sphere(node.means, node.log_scales) for node in nodes]
        self._whole = bool((part.background == 1.0).all()), bool((part.ground == 1.0).all())

    def decode(self, viewpoint: Viewpoint, sky: float, looks: LatentSelector) -> list[Splats]:
        """What the nodes show that a viewpoint may see; nodes that it does not see are not even listed."""
        background, ground, far = (len(select_visible(viewpoint, one[None, :3], one[3:])) > 0 for one in self._spheres)
        far &= sky > LEAST
        if not (background or ground or far):
            return []
        street, shown = self.part.street, []
        latent, content = looks(street.appearance)
        if background:
            splats = street.background.decode(viewpoint, latent, content)
            weights = None if self._whole[0] else self.part.background[splats.rows // street.background.k]
            shown.append(splats if weights is None else fade(splats, weights))
        if ground:
            splats = street.ground.decode(viewpoint, latent)
            shown.append(splats if self._whole[1] else fade(splats, self.part.ground[splats.rows]))
        if far:
            splats = street.sky.decode(viewpoint, latent)
            shown.append(splats if sky == 1.0 else fade(splats, splats.opacities.new_full((len(splats),), sky)))
        return shown


def _nothing(view: RenderView) -> RenderOutput:
    """What a view sees that looks out of the street."""
    rows, columns = view.height_px, view.width_px
    return RenderOutput(torch.zeros(rows, columns, 3), torch.zeros(rows, columns), torch.zeros(rows, columns), (), {})


def _sphere(means: Tensor, log_scales: Tensor) -> Tensor:
    """(4,) centre and radius of a sphere that holds all of a node; of an empty one, a radius that nothing sees."""
    means, log_scales = means.detach(), log_scales.detach()
    if not len(means):
        return means.new_tensor((0.0, 0.0, 0.0, -1e9))
    centre = (means.amin(0) + means.amax(0)) / 2.0
    reach = 3.0 * log_scales.amax(1).exp()
    return torch.cat([centre, ((means - centre).norm(dim=1) + reach).max()[None]])


def _moved(splats: Splats, shift_m: Float64) -> Splats:
    """Gaussians in the frame of another block."""
    if not shift_m.any():
        return splats
    return replace(splats, means=splats.means + splats.means.new_tensor(shift_m))
