"""Renders explicit Gaussians; a `hybridworldsim.trainable.method.CoverRenderableModel`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import torch
from torch import Tensor

from hybridworldsim.rasterizer import rasterization
from hybridworldsim.rasterizer.covers import covered_before
from hybridworldsim.rasterizer.cuda import preset_on
from hybridworldsim.trainable.method import Rendering
from hybridworldsim.trainable.viewpoint import Viewpoint
from mirror.arrays import Float32
from mirror.methods.capabilities import Capabilities
from mirror_baselines.splatting.appearance import FinishedImage
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.settings import Splatting


@dataclass(frozen=True, eq=False)
class RenderOutput:
    """A rendered image, and the tensors whose gradients the optimiser reads.

    Attributes:
        finished: colours.
        alpha: (H, W).
        depth_m: (H, W) expected depth.
        rows: (M,) int64 rows of the tables that may be visible.
        geometry: copies of these rows of each table of geometry, leaves that may require gradients.
        spherical_harmonics: (M, K, 3) coefficients of these rows, likewise.
        meta: results of the rasterizer; ``gaussian_ids`` are rows of the tables.
    """

    finished: FinishedImage
    alpha: Tensor
    depth_m: Tensor
    rows: Tensor
    geometry: dict[str, Tensor]
    spherical_harmonics: Tensor
    meta: dict[str, Any]


class SplattingRenderer:
    """A renderer of Gaussians, with the settings on which their images depend.

    Args:
        model: the model.
        settings: its settings.
    """

    CAPABILITIES: Final = Capabilities(
        renders_depth=True, renders_covers=True, takes_device=True, rasterizes=True, distributes_blocks=True
    )

    def __init__(self, model: Gaussians, settings: Splatting) -> None:
        self.model, self.settings = model, settings

    @torch.no_grad()
    def render(self, viewpoint: Viewpoint) -> Rendering:
        """See `RenderableModel`."""
        return self._to_rendering(self._render(viewpoint, learning=False))

    @torch.no_grad()
    def render_covers(self, viewpoint: Viewpoint, limit_m: Float32) -> tuple[Rendering, Tensor]:
        """See `CoverRenderableModel`."""
        output = self._render(viewpoint, learning=False)
        return self._to_rendering(output), covered_before(output.meta, limit_m)

    def _to_rendering(self, output: RenderOutput) -> Rendering:
        counts = {"held": len(self.model), "decoded": len(output.rows), "drawn": len(output.meta["gaussian_ids"])}
        return Rendering(output.finished.rgb, output.alpha, output.depth_m, counts)

    def _render(self, viewpoint: Viewpoint, *, learning: bool) -> RenderOutput:
        model = self.model
        rows = model.visible_ids(viewpoint)
        geometry, spherical_harmonics = model.geometry(rows), model.spherical_harmonics(rows, viewpoint.source)
        for leaf in (*geometry.values(), spherical_harmonics):
            leaf.requires_grad_(learning)
        device = rows.device
        images, alphas, meta = rasterization(
            geometry["means"],
            geometry["quats"],
            geometry["scales"].exp(),
            geometry["opacities"].sigmoid(),
            spherical_harmonics,
            width=viewpoint.width_px,
            height=viewpoint.height_px,
            **viewpoint.cameras_on(device),
            near_plane=self.settings.near_m,
            sh_degree=int(model.sh_degree),
            render_mode="RGB+ED",
            rasterize_mode="antialiased" if self.settings.antialiased else "classic",
            absgrad=self.settings.densification.absolute,
            preset=preset_on(device),
            nonfinite="cull",
        )
        meta["gaussian_ids"] = rows[meta["gaussian_ids"]]
        alpha = alphas[0, ..., 0]
        finished = model.look.finish(images[0, ..., :3], alpha, viewpoint)
        return RenderOutput(finished, alpha, images[0, ..., 3], rows, geometry, spherical_harmonics, meta)
