"""Sky and ground nodes: Gaussians with a code, from which a network reads the colour."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from hybridworldsim.scene.decoders import Conditioned, decoded
from hybridworldsim.scene.nodes.gathering import shown, told
from hybridworldsim.scene.splats import Splats
from hybridworldsim.scene.visible import visible
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
        means, quats, scales, opacities = shown(rows, self.means, self.quats, self.log_scales, self.logits)
        colours = self.colours(rows, viewpoint, latent)
        return Splats(means, quats, scales, opacities, colours, rows=rows, held=len(self), decoded=len(rows))

    def colours(self, rows: Tensor, viewpoint: Viewpoint, latent: Tensor) -> Tensor:
        """(M, 3) of Gaussians (M,), as a viewpoint sees them."""
        (tints,) = decoded(told(self.codes, rows, self.means, viewpoint.centre), (self.colour, latent))
        return tints.sigmoid()
