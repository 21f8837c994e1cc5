"""The whole network, from pictures to depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from hybridworldsim.mvs.learned.expectation import soft_argmin, window_probability
from hybridworldsim.mvs.learned.view import View
from hybridworldsim.mvs.learned.warping import Motion
from hybridworldsim.mvs.mvsnet.cost_volume import variance_volume
from hybridworldsim.mvs.mvsnet.features import FeatureNet
from hybridworldsim.mvs.mvsnet.planes import DepthPlanes
from hybridworldsim.mvs.mvsnet.refinement import Refinement
from hybridworldsim.mvs.mvsnet.regularisation import CostRegularisation

FEATURE_STRIDE = 4
STRIDE = 32
PLANES_STRIDE = 8


@dataclass(frozen=True, eq=False)
class SourcePicture:
    """A source as the network takes it.

    Attributes:
        rgb: (3, h, w) from 0 to 1; sides are multiples of 4.
        motion: from the reference's features to its own.
        hidden: (h/4, w/4) 1 where a feature is no evidence, else 0; None: nowhere.
    """

    rgb: Tensor
    motion: Motion
    hidden: Tensor | None


class MVSNet(nn.Module):
    """MVSNet; its state dict has the keys of the public PyTorch implementation.

    Args:
        refine: whether it has the refinement, which the public evaluation leaves out.
    """

    def __init__(self, *, refine: bool) -> None:
        super().__init__()
        self.feature = FeatureNet()
        self.cost_regularization = CostRegularisation()
        self.refine_network = Refinement() if refine else None

    def forward(self, rgb: Tensor, sources: Sequence[SourcePicture], planes: DepthPlanes) -> tuple[Tensor, Tensor]:
        """Depth of a picture.

        Args:
            rgb: (3, H, W) from 0 to 1; H and W multiples of 32.
            sources: one at least.
            planes: of depth, a multiple of 8 of them.

        Returns:
            Depth (H/4, W/4): the expected place among the planes; and confidence (H/4, W/4): the probability of the
            four planes about it.
        """
        reference = self.feature(rgb)
        views = [View(self.feature(source.rgb), source.motion, source.hidden) for source in sources]
        score = self.cost_regularization(variance_volume(reference, views, planes.all()))
        probability = score.softmax(0)
        depth = planes.depth_m(soft_argmin(probability, torch.arange(planes.count, dtype=probability.dtype)))
        if self.refine_network is not None:
            extent = planes.far_m - planes.near_m
            residual = self.refine_network(rgb, (depth - planes.near_m) / extent)
            depth = (depth + residual * extent).clamp(planes.near_m, planes.far_m)
        return depth, window_probability(probability)
