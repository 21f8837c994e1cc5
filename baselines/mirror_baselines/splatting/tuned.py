"""Settings for small budgets that all methods of explicit Gaussians share, found by trials of one and two core-minutes.

The trials used one block with 525 images of 240 x 135 of four traversals, with a fifth traversal held out. Compared to
the released values, learning rates of colours are eight times as high, those of places and sizes twice as high, and all
fall to a tenth or less. There are fewer Gaussians; their initial opacity is one half and is never reset. As many grow
as the cap allows, in the order of their gradients, which are summed without signs. Square errors with a tenth of a
structure loss scored 0.2 to 0.8 dB above 3DGS's mixture of absolute errors and structure, and points 0.2 m apart
0.1 dB above points 0.3 m apart (two scenes of the comparison, 4,000 and 5,000 steps).
"""

from __future__ import annotations

from typing import Final

from hybridworldsim.model.settings import Rate
from mirror_baselines.splatting.settings import Densification, GaussianInit, LearningRates, Weights

SEEDING: Final = GaussianInit(most=20_000, spacing_m=0.2, opacity=0.5, ground_spacing_m=0.5)
RATES: Final = LearningRates(
    means=Rate(1.6e-2, 1.6e-4),
    quats=Rate(1e-3, 1e-4),
    scales=Rate(1e-2, 1e-3),
    opacities=Rate(5e-2, 5e-3),
    sh0=Rate(2e-2, 2e-3),
    shN=Rate(2e-3, 2e-4),
)
DENSIFICATION: Final = Densification(
    begin=0.05, end=0.6, rounds=20, resets=0, most=40_000, gradient=0.0, split_m=0.3, largest_m=None, absolute=True
)
WEIGHTS: Final = Weights(structure=0.09, pixelwise="l2", depth=0.02, depth_kind="share")
