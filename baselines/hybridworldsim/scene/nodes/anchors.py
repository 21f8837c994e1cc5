"""Background nodes: anchors, each with a code, from which networks decode the Gaussians round it."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from hybridworldsim.rasterizer.rows import copied_rows
from hybridworldsim.scene.decoders import Conditioned
from hybridworldsim.scene.nodes.assembly import GEOMETRY, assembled
from hybridworldsim.scene.splats import Splats
from hybridworldsim.scene.visible import unit, visible
from hybridworldsim.training.viewpoint import Viewpoint

_OPACITY = 0.3
_SPREAD = 0.5


class Anchors(nn.Module):
    """A node of anchors, after Scaffold-GS.

    Each anchor has k offsets. Of the code, the place, the direction and the appearance one network reads opacity, scale
    and rotation of all k Gaussians, another their colours; an offset's feature is its own rows of the last layers.
    Gaussians of no opacity are dropped before anything is drawn.

    Args:
        means: (N, 3) anchors in the block's frame, metres.
        spacing_m: (N,) size that the offsets and the Gaussians of each begin with.
        radius_m: of the block: places are told to the networks in its units.
        offsets: k.
        code: size of a code.
        latent: size of the appearance's.
        hidden: width of the networks.
    """

    def __init__(
        self, means: Tensor, spacing_m: Tensor, radius_m: float, *, offsets: int, code: int, latent: int, hidden: int
    ) -> None:
        super().__init__()
        count = len(means)
        self.radius_m, self.k = radius_m, offsets
        self.means = nn.Parameter(means.clone(), requires_grad=False)
        self.offsets = nn.Parameter(_SPREAD * (2.0 * torch.rand(count, offsets, 3) - 1.0))
        self.codes = nn.Parameter(torch.zeros(count, code))
        self.log_scales = nn.Parameter(spacing_m.log()[:, None].repeat(1, 6))
        self.geometry = Conditioned(code, 6, latent, hidden, GEOMETRY * offsets, bent=False)
        self.colour = Conditioned(code, 6, latent, hidden, 3 * offsets, bent=True)
        with torch.no_grad():
            # Visible and unturned to begin with: what is not drawn is not learnt.
            bias = self.geometry.out.bias.view(offsets, GEOMETRY)
            bias.zero_()
            bias[:, 0], bias[:, 4] = _OPACITY, 1.0

    def __len__(self) -> int:
        return len(self.means)

    def decode(self, viewpoint: Viewpoint, latent: Tensor, content: Tensor) -> Splats:
        """Gaussians of the anchors that a viewpoint may see.

        Args:
            viewpoint: whence.
            latent: appearance, of the colours.
            content: appearance, of what is there at all (leaves, billboards). It is the same vector but for edits of
                the light, which must not move anything.
        """
        with torch.no_grad():
            reach = 3.0 * self.log_scales.amax(1).exp()
        seen = visible(viewpoint, self.means, reach)
        means = self.means[seen]
        codes, beside = copied_rows(self.codes, seen), self.beside(means, viewpoint)
        geometry, colours = self.geometry(codes, beside, content), self.colour(codes, beside, latent)
        centres, quats, scales, opacities, tints, rows = assembled(
            geometry, colours, seen, self.means, self.offsets, self.log_scales
        )
        return Splats(
            centres,
            quats,
            scales,
            opacities,
            tints,
            rows=rows,
            held=len(self) * self.k,
            decoded=len(seen) * self.k,
            seen=seen,
        )

    def beside(self, means: Tensor, viewpoint: Viewpoint) -> Tensor:
        """(M, 6) what the networks are told of anchors at (M, 3) beside their codes: direction and place."""
        return torch.cat((unit(means - viewpoint.centre), means / self.radius_m), dim=1)
