"""One block of a street: its nodes, its appearance, and how they are rendered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from hybridworldsim.light.recorded_light import RecordedLight
from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.lamps import Lamps, lit_anchors, lit_code_gaussians
from hybridworldsim.model.nodes.anchors import AnchorRows, Anchors
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians, CodeRows
from hybridworldsim.model.splats import DecodedSplats, concatenate_splats
from hybridworldsim.rasterizer import rasterization
from hybridworldsim.rasterizer.cuda import preset_on
from hybridworldsim.trainable.viewpoint import Source, Viewpoint


class NodeRows(NamedTuple):
    """A selection of rows of each node."""

    background: AnchorRows
    ground: CodeRows
    sky: CodeRows


@dataclass(frozen=True, eq=False)
class StreetOutput:
    """A rendered image, and the tensors whose gradients the optimiser reads.

    Attributes:
        rgb: (H, W, 3).
        alpha: (H, W).
        depth_m: (H, W) expected depth.
        parts: decoded Gaussians of each node, in the order of the nodes.
        meta: intermediate results of the rasterizer.
    """

    rgb: Tensor
    alpha: Tensor
    depth_m: Tensor
    parts: tuple[DecodedSplats, ...]
    meta: dict[str, Any]


class StreetModel(nn.Module):
    """The static model of a block.

    Args:
        background: anchors of the background.
        ground: Code-Gaussians on the road and beside it.
        sky: Code-Gaussians around the block; they also represent what stands outside the block.
        appearance: latent vectors.
        light: cameras, exposure and headlights; None: the appearance represents all light.
    """

    def __init__(
        self,
        background: Anchors,
        ground: CodeGaussians,
        sky: CodeGaussians,
        appearance: AppearanceLatents,
        light: RecordedLight | None = None,
    ) -> None:
        super().__init__()
        self.background, self.ground, self.sky, self.appearance = background, ground, sky, appearance
        self.light = light

    @property
    def nodes(self) -> tuple[Anchors, CodeGaussians, CodeGaussians]:
        """The nodes background, ground and sky, in the order in which nodes are listed everywhere."""
        return self.background, self.ground, self.sky

    def decode(
        self,
        viewpoint: Viewpoint,
        latent: Tensor,
        content: Tensor,
        rows: NodeRows | None = None,
        lamps: Lamps | None = None,
    ) -> tuple[DecodedSplats, ...]:
        """Decode each node for a viewpoint: the given rows, or all rows that the viewpoint may see.

        Args:
            viewpoint: the camera.
            latent: appearance of the colours.
            content: appearance of the content.
            rows: rows of each node; default: all that the viewpoint may see.
            lamps: headlights of the vehicle; None: they are off.
        """
        if rows is None:
            visible = [node.visible_ids(viewpoint) for node in self.nodes]
            rows = NodeRows(self.background.rows(visible[0]), self.ground.rows(visible[1]), self.sky.rows(visible[2]))
        background = self.background.decode(viewpoint, latent, content, rows.background)
        ground = self.ground.decode(viewpoint, latent, rows.ground)
        if lamps is not None:
            background = lit_anchors(self.background, rows.background, background, viewpoint, lamps)
            ground = lit_code_gaussians(self.ground, rows.ground, ground, viewpoint, lamps)
        return background, ground, self.sky.decode(viewpoint, latent, rows.sky)

    def lamps(self, viewpoint: Viewpoint, source: Source) -> Lamps | None:
        """Return the headlights of the vehicle that recorded a source; None where it drove without.

        Args:
            viewpoint: the camera that sees the light.
            source: traversal and camera of the appearance.
        """
        light = self.light
        if light is None or light.headlights is None or not light.carries_light(source):
            return None
        with torch.no_grad():
            by_day = torch.stack([self.appearance(one) for one in light.day_sources(source.camera)]).mean(0)
        return Lamps(light.headlights, light.ego_SE3_block(viewpoint, source), by_day)

    def forward(
        self,
        viewpoint: Viewpoint,
        latent: Tensor,
        content: Tensor | None = None,
        *,
        rows: NodeRows | None = None,
        track_gradients: bool = False,
    ) -> StreetOutput:
        """Render a viewpoint.

        Args:
            viewpoint: the camera.
            latent: appearance of the colours.
            content: appearance of the content; default: that of the colours.
            rows: rows of each node; default: all that the viewpoint may see.
            track_gradients: whether the backward pass computes the Gaussians' absolute image gradients.
        """
        lamps = self.lamps(viewpoint, viewpoint.source)
        parts = self.decode(viewpoint, latent, latent if content is None else content, rows, lamps)
        return render(viewpoint, parts, track_gradients=track_gradients)


def render(viewpoint: Viewpoint, parts: tuple[DecodedSplats, ...], *, track_gradients: bool = False) -> StreetOutput:
    """Rasterize the decoded Gaussians of nodes; see `StreetModel.forward`.

    Args:
        viewpoint: the camera.
        parts: the decoded Gaussians.
        track_gradients: whether the backward pass computes the Gaussians' absolute image gradients.
    """
    splats = concatenate_splats(parts)
    images, alphas, meta = rasterization(
        splats.means,
        splats.quats,
        splats.scales,
        splats.opacities,
        splats.colours,
        width=viewpoint.width_px,
        height=viewpoint.height_px,
        **viewpoint.cameras_on(splats.means.device),
        near_plane=0.2,
        render_mode="RGB+ED",
        absgrad=track_gradients,
        preset=preset_on(splats.means.device),
        nonfinite="cull",
    )
    return StreetOutput(images[0, ..., :3], alphas[0, ..., 0], images[0, ..., 3], parts, meta)
