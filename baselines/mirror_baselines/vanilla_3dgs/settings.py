"""Settings of vanilla 3DGS: as released, and as tuned for small budgets."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from hybridworldsim.model.settings import Rate
from mirror_baselines.splatting import tuned
from mirror_baselines.splatting.scaling import scale_splatting
from mirror_baselines.splatting.settings import Splatting

RELEASED: Final = Splatting()
BY_HAND: Final = Splatting(
    seeding=tuned.SEEDING,
    rates=replace(tuned.RATES, shN=Rate(4e-3, 4e-4)),
    densification=tuned.DENSIFICATION,
    weights=tuned.WEIGHTS,
)
"""The middle of the tuning grid."""

TUNED: Final = scale_splatting(BY_HAND, rates=1.0, sizes=2.0)
"""The best cell of the grid (docs/results.md)."""
