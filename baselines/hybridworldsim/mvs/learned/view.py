"""A source picture's features, looked at from the reference."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from hybridworldsim.mvs.learned.warping import Motion, sample, source_positions


@dataclass(frozen=True, eq=False)
class View:
    """A source at one stride.

    Attributes:
        feature: (C, h, w), zero where hidden.
        motion: from samples of the reference to its own.
        hidden: (h, w) 1 where a sample is no evidence, else 0; None: nowhere.
    """

    feature: Tensor
    motion: Motion
    hidden: Tensor | None = None

    def __post_init__(self) -> None:
        if self.hidden is not None:
            object.__setattr__(self, "feature", self.feature * (1.0 - self.hidden))

    def seen(self, depth_m: Tensor) -> tuple[Tensor, Tensor]:
        """What the reference's samples look like in this source.

        Args:
            depth_m: (D, H, W) hypotheses.

        Returns:
            Features (C, D, H, W), bilinear, zero for what is outside or hidden; and how much of each is evidence,
            (D, H, W) or a scalar 1: less than 1 only next to and in what is hidden. What is outside is evidence, as
            published.
        """
        rows, columns = self.feature.shape[1:]
        positions = source_positions(self.motion, depth_m, columns, rows)
        found = sample(self.feature, positions)
        if self.hidden is None:
            return found, torch.ones(())
        return found, 1.0 - sample(self.hidden[None], positions)[0]
