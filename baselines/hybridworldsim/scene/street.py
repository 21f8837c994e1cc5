"""One block of a street: its nodes, its appearance, and how they are drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn

from hybridworldsim.rasterizer import rasterization
from hybridworldsim.scene.appearance import Appearance
from hybridworldsim.scene.nodes.anchors import Anchors
from hybridworldsim.scene.nodes.code_gaussians import CodeGaussians
from hybridworldsim.scene.splats import Splats, joined
from hybridworldsim.training.viewpoint import Viewpoint


@dataclass(frozen=True, eq=False)
class Drawn:
    """A picture with what the optimiser reads.

    Attributes:
        rgb: (H, W, 3).
        alpha: (H, W).
        depth_m: (H, W) expected.
        parts: what each node decoded, in the nodes' order.
        meta: of the rasterizer.
    """

    rgb: Tensor
    alpha: Tensor
    depth_m: Tensor
    parts: tuple[Splats, ...]
    meta: dict[str, Any]


class Street(nn.Module):
    """The static model of a block.

    Args:
        background: its anchors.
        ground: Code-Gaussians on the road and what lies beside it.
        sky: Code-Gaussians round the block; what stands outside the block is among them.
        appearance: latent vectors.
    """

    def __init__(self, background: Anchors, ground: CodeGaussians, sky: CodeGaussians, appearance: Appearance) -> None:
        super().__init__()
        self.background, self.ground, self.sky, self.appearance = background, ground, sky, appearance

    def decode(self, viewpoint: Viewpoint, latent: Tensor, content: Tensor) -> tuple[Splats, ...]:
        """What each node shows a viewpoint: background, ground, sky."""
        return (
            self.background.decode(viewpoint, latent, content),
            self.ground.decode(viewpoint, latent),
            self.sky.decode(viewpoint, latent),
        )

    def forward(
        self, viewpoint: Viewpoint, latent: Tensor, content: Tensor | None = None, *, pulls: bool = False
    ) -> Drawn:
        """Draw a viewpoint.

        Args:
            viewpoint: whence.
            latent: appearance of the colours.
            content: appearance of what is there; default: the same.
            pulls: the backward pass is to tell how strongly the picture pulls at its Gaussians.
        """
        parts = self.decode(viewpoint, latent, latent if content is None else content)
        return draw(viewpoint, parts, pulls=pulls)


def draw(viewpoint: Viewpoint, parts: tuple[Splats, ...], *, pulls: bool = False) -> Drawn:
    """Rasterize what nodes show; see `Street.forward`."""
    splats = joined(parts)
    pictures, alphas, meta = rasterization(
        splats.means,
        splats.quats,
        splats.scales,
        splats.opacities,
        splats.colours,
        viewpoint.viewmat[None],
        viewpoint.K[None],
        viewpoint.width_px,
        viewpoint.height_px,
        near_plane=0.2,
        render_mode="RGB+ED",
        absgrad=pulls,
        nonfinite="cull",
    )
    return Drawn(pictures[0, ..., :3], alphas[0, ..., 0], pictures[0, ..., 3], parts, meta)
