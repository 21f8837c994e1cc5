"""Background nodes: anchors, each with a code, from which networks decode the Gaussians round it."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from hybridworldsim.scene.decoders import Conditioned, decoded
from hybridworldsim.scene.nodes.assembly import GEOMETRY, assembled
from hybridworldsim.scene.nodes.gathering import told
from hybridworldsim.scene.splats import Splats
from hybridworldsim.scene.visible import visible
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
        geometry, colours = self.read(seen, viewpoint, latent, content)
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

    def read(self, rows: Tensor, viewpoint: Viewpoint, latent: Tensor, content: Tensor) -> tuple[Tensor, Tensor]:
        """What the networks say of anchors (M,), (M, k * 8) and (M, k * 3); see `assembled`."""
        facts = told(self.codes, rows, self.means, viewpoint.centre, self.radius_m)
        geometry, colours = decoded(facts, (self.geometry, content), (self.colour, latent))
        return geometry, colours
