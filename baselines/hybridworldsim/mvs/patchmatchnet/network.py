"""The whole network, from pictures to depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from hybridworldsim.mvs.learned.expectation import window_probability
from hybridworldsim.mvs.learned.view import View
from hybridworldsim.mvs.learned.warping import Motion
from hybridworldsim.mvs.patchmatchnet.features import FeaturePyramid
from hybridworldsim.mvs.patchmatchnet.refinement import Refinement
from hybridworldsim.mvs.patchmatchnet.stage import LEVELS, Estimate, Range, Stage

STRIDE = 8


@dataclass(frozen=True, eq=False)
class SourcePicture:
    """A source as the network takes it.

    Attributes:
        rgb: (3, h, w) from 0 to 1; sides are multiples of 8.
        motions: from the reference's samples to its own, by stride.
        hidden: by stride, 1 where a sample is no evidence, else 0; empty: none is.
    """

    rgb: Tensor
    motions: dict[int, Motion]
    hidden: dict[int, Tensor]


class PatchmatchNet(nn.Module):
    """PatchmatchNet (Wang et al. 2021) in the published configuration; its state dict has the published keys."""

    def __init__(self) -> None:
        super().__init__()
        self.feature = FeaturePyramid()
        for number, level in zip((3, 2, 1), LEVELS):
            self.add_module(f"patchmatch_{number}", Stage(level, last=level is LEVELS[-1]))
        self.upsample_net = Refinement()

    def forward(
        self, rgb: Tensor, sources: Sequence[SourcePicture], near_m: float, far_m: float, draws: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """Depth of a picture.

        Args:
            rgb: (3, H, W) from 0 to 1; H and W multiples of 8.
            sources: one at least.
            near_m: smallest depth searched.
            far_m: largest depth searched.
            draws: for the first hypotheses.

        Returns:
            Depth (H, W), and confidence (H, W): the probability of four of the last stage's eight hypotheses.
        """
        inverse = Range(1.0 / far_m, 1.0 / near_m)
        reference = self.feature(rgb)
        features = [self.feature(source.rgb) for source in sources]
        estimate: Estimate | None = None
        for number, level in zip((3, 2, 1), LEVELS):
            views = [
                View(feature[level.stride], source.motions[level.stride], source.hidden.get(level.stride))
                for feature, source in zip(features, sources)
            ]
            if estimate is not None:
                estimate = Estimate(
                    _doubled(estimate.depth_m[None])[0], estimate.probability, _doubled(estimate.view_weights)
                )
            stage = self.get_submodule(f"patchmatch_{number}")
            estimate = stage(reference[level.stride], views, inverse, estimate, draws)
        if estimate is None:
            raise RuntimeError("a network of no stages")
        extent = far_m - near_m
        residual = self.upsample_net(rgb, (estimate.depth_m - near_m) / extent)
        # Added in metres: as a share of a long range, float32 would not tell near depths apart.
        refined = _doubled(estimate.depth_m[None])[0] + residual * extent
        return refined.clamp(near_m, far_m), _doubled(window_probability(estimate.probability)[None])[0]


def _doubled(x: Tensor) -> Tensor:
    return functional.interpolate(x[None], scale_factor=2.0, mode="nearest")[0]
