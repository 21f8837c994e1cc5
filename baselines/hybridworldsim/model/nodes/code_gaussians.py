"""Sky and ground nodes: Gaussians with a code, from which a network decodes the colour."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn

from hybridworldsim.model.decoders import ModulatedMLP
from hybridworldsim.model.nodes.network_inputs import select_rows
from hybridworldsim.model.nodes.networks import run_networks
from hybridworldsim.model.splats import DecodedSplats
from hybridworldsim.model.visible import select_visible
from hybridworldsim.trainable.viewpoint import Viewpoint

_SIGMAS = 3.0


@dataclass(frozen=True, eq=False)
class Seeds:
    """Initial Gaussians of a node.

    Attributes:
        means: (N, 3) in the block's frame, metres.
        quats: (N, 4) scalar first.
        scales: (N, 3) metres.
        opacity: opacity of every Gaussian.
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacity: float


@dataclass(frozen=True, eq=False)
class CodeRows:
    """The parameters of M Code-Gaussians, gathered from the tables of their node.

    Attributes:
        ids: (M,) int64 indices of the Gaussians, ascending.
        means: (M, 3).
        quats: (M, 4).
        log_scales: (M, 3).
        logits: (M,) logits of the opacities.
        codes: (M, F).
    """

    ids: Tensor
    means: Tensor
    quats: Tensor
    log_scales: Tensor
    logits: Tensor
    codes: Tensor


class CodeGaussians(nn.Module):
    """A node of Code-Gaussians.

    Args:
        seeds: the initial Gaussians.
        code: size of a code.
        latent: size of the appearance latent.
        hidden: width of the network.
    """

    TABLES: ClassVar = ("means", "quats", "log_scales", "logits", "codes")

    def __init__(self, seeds: Seeds, code: int, latent: int, hidden: int) -> None:
        super().__init__()
        count = len(seeds.means)
        self.means = nn.Parameter(seeds.means.clone())
        self.quats = nn.Parameter(seeds.quats.clone())
        self.log_scales = nn.Parameter(seeds.scales.log())
        self.logits = nn.Parameter(torch.full((count,), seeds.opacity).logit())
        self.codes = nn.Parameter(torch.zeros(count, code))
        self.colour = ModulatedMLP(code, 3, latent, hidden, 3, modulated=True)

    def __len__(self) -> int:
        return len(self.means)

    def visible_ids(self, viewpoint: Viewpoint, reach_m: Tensor | None = None) -> Tensor:
        """Return the Gaussians (M,) that a viewpoint may see, int64; `reach_m` is computed unless it is given."""
        return select_visible(viewpoint, self.means, self.reach_m() if reach_m is None else reach_m)

    @torch.no_grad()
    def reach_m(self) -> Tensor:
        """Return the radius (N,) of a sphere around each Gaussian that holds its visible part."""
        return _SIGMAS * self.log_scales.amax(1).exp()

    def rows(self, ids: Tensor, learnt: Mapping[str, Tensor] | None = None) -> CodeRows:
        """Gather the rows of Gaussians (M,); tables in `learnt` are already gathered and are not read again."""
        return CodeRows(ids, **select_rows(self, self.TABLES, ids, learnt or {}))

    def decode(self, viewpoint: Viewpoint, latent: Tensor, rows: CodeRows | None = None) -> DecodedSplats:
        """Decode the colours of Gaussians.

        Args:
            viewpoint: the camera.
            latent: appearance of the colours.
            rows: the Gaussians; None: all that the viewpoint may see.
        """
        rows = rows or self.rows(self.visible_ids(viewpoint))
        return DecodedSplats(
            rows.means,
            rows.quats,
            rows.log_scales.exp(),
            rows.logits.sigmoid(),
            self.colours(rows, viewpoint, latent),
            rows=rows.ids,
            stored_count=len(self),
            decoded_count=len(rows.ids),
        )

    def colours(self, rows: CodeRows, viewpoint: Viewpoint, latent: Tensor) -> Tensor:
        """Return the colours (M, 3) of Gaussians for a viewpoint."""
        (tints,) = run_networks(rows.codes, rows.means, viewpoint.centre, None, (self.colour, latent))
        return tints.sigmoid()
