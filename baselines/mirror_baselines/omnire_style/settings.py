"""Settings of the OmniRe-style method: as released in drivestudio, and as tuned for small budgets."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

from hybridworldsim.model.settings import Rate
from mirror_baselines.splatting import tuned
from mirror_baselines.splatting.scaling import scale_splatting
from mirror_baselines.splatting.settings import Densification, GaussianInit, LearningRates, Splatting, Weights


@dataclass(frozen=True)
class OmnireStyle(Splatting):
    """The settings of `Splatting` and of OmniRe.

    Attributes:
        embedding: size of an image's embedding.
        hidden: width of the network that computes the affine colour map from the embedding.
        affine: learning rate of both.
        sky_px: width of a face of the sky cube.
        sky: learning rate of the sky cube.
        opacity_weight: weight of the cross entropy between the Gaussians' alpha and the pixels that are not sky.
    """

    embedding: int = 4
    hidden: int = 64
    affine: Rate = field(default=Rate(1e-5, 1e-5))
    sky_px: int = 128
    sky: Rate = field(default=Rate(1e-2, 1e-2))
    opacity_weight: float = 0.05


RELEASED: Final = OmnireStyle(
    seeding=GaussianInit(sky_count=0, far_count=4_000),
    rates=LearningRates(means=Rate(8e-3, 8e-5)),
    densification=Densification(gradient=5e-4, split_m=0.15, largest_m=None, absolute=True),
    weights=Weights(depth=0.01, depth_kind="metres"),
    near_m=0.1,
)
"""From drivestudio's configs/omnire.yaml (commit e59bda4f); counts and schedules are shares of 30,000 steps. Its sky
faces are 1024 pixels wide for images of 1600; these are for images of 240."""

BY_HAND: Final = OmnireStyle(
    seeding=replace(tuned.SEEDING, sky_count=0),
    rates=tuned.RATES,
    densification=tuned.DENSIFICATION,
    weights=tuned.WEIGHTS,
    sh_degree=1,
    affine=Rate(1e-3, 1e-4),
)
"""The middle of the tuning grid."""

TUNED: Final = scale_splatting(BY_HAND, rates=2.0, sizes=2.0)
"""The best cell of the grid (docs/results.md)."""
