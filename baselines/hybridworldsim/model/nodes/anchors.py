"""Background nodes: anchors, each with a code, from which networks decode the Gaussians around it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn

from hybridworldsim.model.decoders import ModulatedMLP
from hybridworldsim.model.nodes.gaussian_assembly import GEOMETRY, anchors_to_gaussians, rows_of_slots
from hybridworldsim.model.nodes.network_inputs import select_rows
from hybridworldsim.model.nodes.networks import run_networks
from hybridworldsim.model.splats import DecodedSplats
from hybridworldsim.model.visible import select_visible
from hybridworldsim.trainable.viewpoint import Viewpoint

_OPACITY = 0.3
_SPREAD = 0.5


@dataclass(frozen=True, eq=False)
class AnchorRows:
    """Rows of the tables of some anchors.

    Attributes:
        ids: (M,) int64 indices of the anchors, ascending.
        means: (M, 3).
        offsets: (M, k, 3).
        codes: (M, F).
        log_scales: (M, 6).
    """

    ids: Tensor
    means: Tensor
    offsets: Tensor
    codes: Tensor
    log_scales: Tensor


class Anchors(nn.Module):
    """A node of anchors, as in Scaffold-GS.

    Each anchor has k offsets. Two networks read the code, the place, the direction and the appearance: one returns
    opacity, scale and rotation of all k Gaussians, the other their colours. Each offset has its own rows of the last
    layers. Gaussians with an opacity of zero are dropped before rasterization.

    Args:
        means: (N, 3) anchors in the block's frame, metres.
        spacing_m: (N,) initial size of the offsets and of the Gaussians of each anchor.
        radius_m: radius of the block, the unit of places in the networks' inputs.
        offsets: k, number of offsets of an anchor.
        code: size of a code.
        latent: size of the appearance latent.
        hidden: width of the networks.
    """

    TABLES: ClassVar = ("means", "offsets", "codes", "log_scales")

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
        self.geometry = ModulatedMLP(code, 6, latent, hidden, GEOMETRY * offsets, modulated=False)
        self.colour = ModulatedMLP(code, 6, latent, hidden, 3 * offsets, modulated=True)
        with torch.no_grad():
            # Begin visible and without rotation: a Gaussian that is not rendered gets no gradient.
            bias = self.geometry.out.bias.view(offsets, GEOMETRY)
            bias.zero_()
            bias[:, 0], bias[:, 4] = _OPACITY, 1.0

    def __len__(self) -> int:
        return len(self.means)

    def visible_ids(self, viewpoint: Viewpoint, reach_m: Tensor | None = None) -> Tensor:
        """Return the anchors (M,) that a viewpoint may see, int64; `reach_m` is computed unless it is given."""
        return select_visible(viewpoint, self.means, self.reach_m() if reach_m is None else reach_m)

    @torch.no_grad()
    def reach_m(self) -> Tensor:
        """Return the radius (N,) of a sphere around each anchor that holds its Gaussians.

        It is three times the anchor's largest scale.
        """
        return 3.0 * self.log_scales.amax(1).exp()

    def rows(self, ids: Tensor, learnt: Mapping[str, Tensor] | None = None) -> AnchorRows:
        """Gather the rows of anchors (M,); tables in `learnt` are already gathered and are not read again."""
        return AnchorRows(ids, **select_rows(self, self.TABLES, ids, learnt or {}))

    def decode(
        self, viewpoint: Viewpoint, latent: Tensor, content: Tensor, rows: AnchorRows | None = None
    ) -> DecodedSplats:
        """Decode the Gaussians of anchors.

        Args:
            viewpoint: the camera.
            latent: appearance of the colours.
            content: appearance of the content (leaves, billboards). It differs from `latent` only when the light is
                edited, which must not move anything.
            rows: the anchors; None: all that the viewpoint may see.
        """
        rows = rows or self.rows(self.visible_ids(viewpoint))
        geometry, colours = self.read(rows, viewpoint, latent, content)
        gaussians = anchors_to_gaussians(geometry, colours, rows.means, rows.offsets, rows.log_scales)
        return DecodedSplats(
            gaussians.means,
            gaussians.quats,
            gaussians.scales,
            gaussians.opacities,
            gaussians.colours,
            rows=rows_of_slots(gaussians.slots, rows.ids, self.k),
            stored_count=len(self) * self.k,
            decoded_count=len(rows.ids) * self.k,
            anchor_ids=rows.ids,
        )

    def daylit(self, rows: AnchorRows, viewpoint: Viewpoint, latent: Tensor) -> Tensor:
        """Return the colours (M, k * 3) of all Gaussians of anchors in an appearance."""
        network = self.colour, latent
        (colours,) = run_networks(rows.codes, rows.means, viewpoint.centre, self.radius_m, network)
        return colours.sigmoid()

    def read(self, rows: AnchorRows, viewpoint: Viewpoint, latent: Tensor, content: Tensor) -> tuple[Tensor, Tensor]:
        """Return the networks' outputs for anchors, (M, k * 8) and (M, k * 3); see `anchors_to_gaussians`."""
        networks = (self.geometry, content), (self.colour, latent)
        geometry, colours = run_networks(rows.codes, rows.means, viewpoint.centre, self.radius_m, *networks)
        return geometry, colours
