"""Cells of the tuning's grid: our settings with all learning rates and all numbers of Gaussians multiplied."""

from __future__ import annotations

from dataclasses import replace

from hybridworldsim.model.settings import Settings
from mirror_baselines.splatting.scaling import scale_rates


def scale_settings(settings: Settings, rates: float, sizes: float) -> Settings:
    """Multiply all learning rates by `rates` and all numbers of Gaussians by `sizes`."""
    grown = settings.refinement
    return replace(
        settings,
        rates=scale_rates(settings.rates, rates),
        first_anchors=round(sizes * settings.first_anchors),
        refinement=replace(
            grown,
            max_anchors=round(sizes * grown.max_anchors),
            most_ground=round(sizes * grown.most_ground),
            most_sky=round(sizes * grown.most_sky),
        ),
    )
