"""The complete MVSNet network, from images to depth."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from hybridworldsim.mvs.learned.expectation import compute_window_probability, soft_argmin
from hybridworldsim.mvs.learned.images import SourceImage
from hybridworldsim.mvs.mvsnet.cost_volume import compute_variance_volume
from hybridworldsim.mvs.mvsnet.features import FeatureNet
from hybridworldsim.mvs.mvsnet.planes import DepthPlanes
from hybridworldsim.mvs.mvsnet.refinement import Refinement
from hybridworldsim.mvs.mvsnet.regularisation import CostRegularisation

FEATURE_STRIDE = 4
STRIDE = 32
PLANES_STRIDE = 8


class MVSNet(nn.Module):
    """MVSNet; its state dict has the keys of the public PyTorch implementation.

    Args:
        refine: whether it has the refinement network, which the public evaluation leaves out.
    """

    def __init__(self, *, refine: bool) -> None:
        super().__init__()
        self.feature = FeatureNet()
        self.cost_regularization = CostRegularisation()
        self.refine_network = Refinement() if refine else None

    def forward(self, rgb: Tensor, sources: Sequence[SourceImage], planes: DepthPlanes) -> tuple[Tensor, Tensor]:
        """Estimate the depth of an image.

        Args:
            rgb: (3, H, W) from 0 to 1; H and W are multiples of 32.
            sources: at least one, with sides that are multiples of 4.
            planes: the depth planes; their number is a multiple of 8.

        Returns:
            Depth (H/4, W/4), at the expected plane index; and confidence (H/4, W/4), the probability of the four planes
            around that index.
        """
        reference = self.feature(rgb)
        features = [source.with_features(FEATURE_STRIDE, self.feature(source.rgb)) for source in sources]
        score = self.cost_regularization(compute_variance_volume(reference, features, planes.depths_m().to(rgb.device)))
        probability = score.softmax(0)
        depth = planes.depth_at(
            soft_argmin(probability, torch.arange(planes.count, dtype=probability.dtype, device=rgb.device))
        )
        if self.refine_network is not None:
            extent = planes.far_m - planes.near_m
            residual = self.refine_network(rgb, (depth - planes.near_m) / extent)
            depth = (depth + residual * extent).clamp(planes.near_m, planes.far_m)
        return depth, compute_window_probability(probability)
