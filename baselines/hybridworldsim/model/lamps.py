"""Headlights on the Gaussians of a street."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from hybridworldsim.light.headlights import HeadlightField, add_light
from hybridworldsim.model.nodes.anchors import AnchorRows, Anchors
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians, CodeRows
from hybridworldsim.model.splats import DecodedSplats
from hybridworldsim.trainable.viewpoint import Viewpoint


@dataclass(frozen=True, eq=False)
class Lamps:
    """The headlights of one vehicle at one instant.

    Attributes:
        field: the light in the vehicle's frame.
        ego_SE3_block: (4, 4) from the block's frame to the vehicle's.
        by_day: (latent,) the appearance whose colours stand for the reflectance.
        share: factor of the light, from 0 (off) to 1.
    """

    field: HeadlightField
    ego_SE3_block: Tensor
    by_day: Tensor
    share: float = 1.0


def lit_anchors(
    node: Anchors, rows: AnchorRows, splats: DecodedSplats, viewpoint: Viewpoint, lamps: Lamps
) -> DecodedSplats:
    """Return the Gaussians of anchors under headlights.

    Args:
        node: the node.
        rows: the decoded anchors.
        splats: their Gaussians, as `Anchors.decode` returns them.
        viewpoint: the camera.
        lamps: the headlights.
    """
    with torch.no_grad():
        places = torch.searchsorted(rows.ids, splats.rows // node.k)
        tints = node.daylit(rows, viewpoint, lamps.by_day)
        daylit = tints.view(-1, 3)[places * node.k + splats.rows % node.k]
    return _lit(splats, daylit, lamps, ground=False)


def lit_code_gaussians(
    node: CodeGaussians, rows: CodeRows, splats: DecodedSplats, viewpoint: Viewpoint, lamps: Lamps
) -> DecodedSplats:
    """Return the Gaussians of the ground under headlights; see `lit_anchors`."""
    with torch.no_grad():
        daylit = node.colours(rows, viewpoint, lamps.by_day)
    return _lit(splats, daylit, lamps, ground=True)


def _lit(splats: DecodedSplats, daylit: Tensor, lamps: Lamps, *, ground: bool) -> DecodedSplats:
    # The reflectance belongs to the images by day, and no light moves a Gaussian.
    light = lamps.share * lamps.field(splats.means.detach(), lamps.ego_SE3_block.to(splats.means.device), ground=ground)
    return replace(splats, colours=add_light(splats.colours, daylit, light))
