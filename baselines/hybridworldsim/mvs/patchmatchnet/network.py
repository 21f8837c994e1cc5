"""The complete PatchmatchNet network, from images to depth."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from hybridworldsim.mvs.learned.expectation import compute_window_probability
from hybridworldsim.mvs.learned.images import SourceImage
from hybridworldsim.mvs.patchmatchnet.features import FeaturePyramid
from hybridworldsim.mvs.patchmatchnet.refinement import PatchmatchRefinement
from hybridworldsim.mvs.patchmatchnet.stage import LEVELS, InverseDepthRange, PatchmatchStage, StageEstimate

STRIDE = 8


class PatchmatchNet(nn.Module):
    """PatchmatchNet (Wang et al. 2021) in the published configuration; its state dict has the published keys."""

    def __init__(self) -> None:
        super().__init__()
        self.feature = FeaturePyramid()
        for number, level in zip((3, 2, 1), LEVELS):
            self.add_module(f"patchmatch_{number}", PatchmatchStage(level, last=level is LEVELS[-1]))
        self.upsample_net = PatchmatchRefinement()

    def forward(
        self, rgb: Tensor, sources: Sequence[SourceImage], near_m: float, far_m: float, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Estimate the depth of an image.

        Args:
            rgb: (3, H, W) from 0 to 1; H and W are multiples of 8.
            sources: at least one, with sides that are multiples of 8.
            near_m: smallest depth searched.
            far_m: largest depth searched.
            generator: of the first hypotheses' random numbers.

        Returns:
            Depth (H, W), and confidence (H, W): the probability of four of the last stage's eight hypotheses.
        """
        inverse = InverseDepthRange(1.0 / far_m, 1.0 / near_m)
        reference = self.feature(rgb)
        features = [self.feature(source.rgb) for source in sources]
        estimate: StageEstimate | None = None
        for number, level in zip((3, 2, 1), LEVELS):
            source_features = [
                source.with_features(level.stride, feature[level.stride]) for feature, source in zip(features, sources)
            ]
            if estimate is not None:
                estimate = StageEstimate(
                    _double(estimate.depth_m[None])[0], estimate.probability, _double(estimate.view_weights)
                )
            stage = self.get_submodule(f"patchmatch_{number}")
            estimate = stage(reference[level.stride], source_features, inverse, estimate, generator)
        if estimate is None:
            raise RuntimeError("the network has no stages")
        extent = far_m - near_m
        residual = self.upsample_net(rgb, (estimate.depth_m - near_m) / extent)
        # The sum is in metres: as shares of a long range, float32 could not distinguish near depths.
        refined = _double(estimate.depth_m[None])[0] + residual * extent
        return refined.clamp(near_m, far_m), _double(compute_window_probability(estimate.probability)[None])[0]


def _double(x: Tensor) -> Tensor:
    """Double the sides of (C, H, W) by repeating each sample."""
    return functional.interpolate(x[None], scale_factor=2.0, mode="nearest")[0]
