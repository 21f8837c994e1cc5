"""Sky and ground nodes: Gaussians with a code, from which a network reads the colour."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from hybridworldsim.rasterizer.rows import copied_rows
from hybridworldsim.scene.decoders import Conditioned
from hybridworldsim.scene.splats import Splats
from hybridworldsim.scene.visible import unit, visible
from hybridworldsim.training.viewpoint import Viewpoint

_SIGMAS = 3.0


@dataclass(frozen=True, eq=False)
class Seeds:
    """Gaussians to begin with.

    Attributes:
        means: (N, 3) in the block's frame, metres.
        quats: (N, 4) scalar first.
        scales: (N, 3) metres.
        opacity: of each.
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacity: float


class CodeGaussians(nn.Module):
    """A node of Code-Gaussians.

    Args:
        seeds: what it begins with.
        code: size of a code.
        latent: size of the appearance's.
        hidden: width of the network.
    """

    def __init__(self, seeds: Seeds, code: int, latent: int, hidden: int) -> None:
        super().__init__()
        count = len(seeds.means)
        self.means = nn.Parameter(seeds.means.clone())
        self.quats = nn.Parameter(seeds.quats.clone())
        self.log_scales = nn.Parameter(seeds.scales.log())
        self.logits = nn.Parameter(torch.full((count,), seeds.opacity).logit())
        self.codes = nn.Parameter(torch.zeros(count, code))
        self.colour = Conditioned(code, 3, latent, hidden, 3, bent=True)

    def __len__(self) -> int:
        return len(self.means)

    def decode(self, viewpoint: Viewpoint, latent: Tensor) -> Splats:
        """Those that a viewpoint may see.

        Args:
            viewpoint: whence.
            latent: appearance.
        """
        with torch.no_grad():
            reach = _SIGMAS * self.log_scales.amax(1).exp()
        rows = visible(viewpoint, self.means, reach)
        means = copied_rows(self.means, rows)
        directions = unit(means.detach() - viewpoint.centre)
        colours = self.colour(copied_rows(self.codes, rows), directions, latent).sigmoid()
        return Splats(
            means,
            copied_rows(self.quats, rows),
            copied_rows(self.log_scales, rows).exp(),
            copied_rows(self.logits, rows).sigmoid(),
            colours,
            rows=rows,
            held=len(self),
            decoded=len(rows),
        )
