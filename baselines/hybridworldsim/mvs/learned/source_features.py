"""The features of a source image, and their warping to the reference."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from hybridworldsim.mvs.learned.warping import SampleMotion, project_to_source, sample


@dataclass(frozen=True, eq=False)
class SourceFeatures:
    """The features of a source at one stride.

    Attributes:
        feature: (C, h, w); set to zero where hidden.
        motion: from samples of the reference to samples of the source.
        hidden: (h, w) 1 where a sample is no evidence, else 0; None if all samples are evidence.
    """

    feature: Tensor
    motion: SampleMotion
    hidden: Tensor | None = None

    def __post_init__(self) -> None:
        if self.hidden is not None:
            object.__setattr__(self, "feature", self.feature * (1.0 - self.hidden))

    def warp(self, depth_m: Tensor) -> tuple[Tensor, Tensor]:
        """Sample the source's features at the reference's samples, for depth hypotheses.

        Args:
            depth_m: (D, H, W) hypotheses.

        Returns:
            Features (C, D, H, W), bilinear, zero outside the source and where it is hidden; and the share of each
            that is evidence, (D, H, W) or a scalar 1. The share is below 1 only in and next to hidden samples: samples
            outside the source count as evidence, as in the published networks.
        """
        rows, columns = self.feature.shape[1:]
        positions = project_to_source(self.motion, depth_m, columns, rows)
        warped = sample(self.feature, positions)
        if self.hidden is None:
            return warped, torch.ones((), device=warped.device)
        return warped, 1.0 - sample(self.hidden[None], positions)[0]
