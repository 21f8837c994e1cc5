"""Our settings with all learning rates, or all numbers of Gaussians, times something: cells of the tuning's grid."""

from __future__ import annotations

from dataclasses import replace

from hybridworldsim.model.settings import Settings
from mirror_baselines.splatting.scaled import faster


def scaled_street(settings: Settings, rates: float, sizes: float) -> Settings:
    """Our settings with all learning rates and all numbers of Gaussians times something."""
    grown = settings.refinement
    return replace(
        settings,
        rates=faster(settings.rates, rates),
        first_anchors=round(sizes * settings.first_anchors),
        refinement=replace(
            grown,
            most=round(sizes * grown.most),
            most_ground=round(sizes * grown.most_ground),
            most_sky=round(sizes * grown.most_sky),
        ),
    )
