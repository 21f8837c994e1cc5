"""Settings of the MTGS-style method: as released by MTGS, and as tuned for small budgets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from hybridworldsim.model.settings import Rate
from mirror_baselines.splatting import tuned
from mirror_baselines.splatting.scaling import scale_splatting
from mirror_baselines.splatting.settings import Densification, GaussianInit, LearningRates, Splatting, Weights


@dataclass(frozen=True)
class MtgsStyle(Splatting):
    """The settings of `Splatting` and of MTGS.

    Attributes:
        exposure: learning rate of each training image's colour matrix; None: there are no matrices.
    """

    exposure: Rate | None = None


RELEASED: Final = MtgsStyle(
    seeding=GaussianInit(spacing_m=0.15, sky_count=6_000),
    rates=LearningRates(
        means=Rate(8e-4, 8e-6),
        shN=Rate(1.25e-4, 1.25e-4),
    ),
    densification=Densification(gradient=1e-3, split_m=0.2, largest_m=None, absolute=True),
    weights=Weights(depth=0.5, depth_kind="inverse", normal=1e-5),
    antialiased=True,
    exposure=Rate(1e-3, 1e-4),
)
"""From MTGS's config/MTGS.py (commit 8e16dbb5); counts and schedules are shares of 30,000 steps. There, traversals
differ in the higher bands only: its `features_adapters` have the learning rate 0 and are left out here. Large Gaussians
are kept, as its sky is; its normals come from LiDAR, here the street's normal loss is used with the street's weight."""

BY_HAND: Final = MtgsStyle(
    seeding=tuned.SEEDING,
    rates=replace(tuned.RATES, adapter=Rate(2e-2, 2e-3)),
    densification=tuned.DENSIFICATION,
    weights=tuned.WEIGHTS,
    sh_degree=1,
    antialiased=True,
)
"""The middle of the tuning grid. Traversals differ in the constant band, and the first band is the highest."""

TUNED: Final = scale_splatting(BY_HAND, rates=1.0, sizes=2.0)
"""The best cell at these rates: twice the rates score higher after two core-minutes, and lower after ten
(docs/results.md)."""
