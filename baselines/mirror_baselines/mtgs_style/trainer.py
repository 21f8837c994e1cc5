"""A learner of the MTGS-style method."""

from __future__ import annotations

from hybridworldsim.model.initialization import Initial
from mirror_baselines.mtgs_style.appearance import TraversalLook
from mirror_baselines.mtgs_style.settings import MtgsStyle
from mirror_baselines.splatting.gaussian_init import seeded
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.trainer import SplattingLearner


def make(initial: Initial, settings: MtgsStyle) -> SplattingLearner:
    """A model that has seen no picture yet.

    Args:
        initial: what is known of the block; its sources say which traversals there are.
        settings: `RELEASED`, `TUNED` or others.
    """
    look = TraversalLook(
        settings.sh_degree,
        initial.sources,
        adapters=settings.rates.adapter is not None,
        exposure=settings.exposure,
    )
    return SplattingLearner(Gaussians(seeded(initial, settings.seeding), look), settings)
