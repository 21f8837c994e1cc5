"""A learner of the MTGS-style method."""

from __future__ import annotations

from hybridworldsim.model.initialization import InitialGeometry
from mirror_baselines.mtgs_style.appearance import TraversalAppearance
from mirror_baselines.mtgs_style.settings import MtgsStyle
from mirror_baselines.splatting.gaussian_init import initial_gaussians
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.trainer import SplattingTrainer


def make(initial: InitialGeometry, settings: MtgsStyle) -> SplattingTrainer:
    """A model that has seen no image yet.

    Args:
        initial: what is known of the block; its sources say which traversals there are.
        settings: `RELEASED`, `TUNED` or others.
    """
    look = TraversalAppearance(
        settings.sh_degree,
        initial.sources,
        adapters=settings.rates.adapter is not None,
        exposure=settings.exposure,
    )
    return SplattingTrainer(Gaussians(initial_gaussians(initial, settings.seeding), look), settings)
