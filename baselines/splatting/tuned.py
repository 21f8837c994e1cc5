"""What small budgets want of all methods of explicit Gaussians: found by trials of one and two core-minutes.

Trials were on one block with 525 pictures of 240 x 135 of four traversals, a held-out fifth beside them. Against the
released values: rates of colours eight times as high and falling to a tenth, half as many Gaussians, which are opaque
from the beginning and never reset, and as many grown as the cap lets in, by the order of their gradients.
"""

from __future__ import annotations

from typing import Final

from hybridworldsim.scene.settings import Rate
from splatting.settings import Densification, Rates, Seeding, Weights

SEEDING: Final = Seeding(most=10_000, spacing_m=0.3, opacity=0.5, ground_spacing_m=0.5)
RATES: Final = Rates(
    means=Rate(8e-3, 8e-5),
    quats=Rate(1e-3, 1e-4),
    scales=Rate(5e-3, 5e-4),
    opacities=Rate(5e-2, 5e-3),
    sh0=Rate(2e-2, 2e-3),
    shN=Rate(2e-3, 2e-4),
)
DENSIFICATION: Final = Densification(
    begin=0.05, end=0.6, rounds=20, resets=0, most=40_000, gradient=0.0, split_m=0.3, largest_m=None
)
WEIGHTS: Final = Weights(structure=0.2, pixelwise="l1", depth=0.02, depth_kind="share")
