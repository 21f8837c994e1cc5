"""A learner of vanilla 3DGS."""

from __future__ import annotations

from hybridworldsim.model.initialization import Initial
from mirror_baselines.splatting.appearance import Look
from mirror_baselines.splatting.gaussian_init import seeded
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.settings import Splatting
from mirror_baselines.splatting.trainer import SplattingLearner


def make(initial: Initial, settings: Splatting) -> SplattingLearner:
    """A model that has seen no picture yet.

    Args:
        initial: what is known of the block.
        settings: `RELEASED`, `TUNED` or others.
    """
    return SplattingLearner(Gaussians(seeded(initial, settings.seeding), Look(settings.sh_degree)), settings)
