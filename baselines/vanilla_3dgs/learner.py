"""A learner of vanilla 3DGS."""

from __future__ import annotations

from hybridworldsim.scene.seeding import Initial
from splatting.learner import SplattingLearner
from splatting.look import Look
from splatting.model import Gaussians
from splatting.seeding import seeded
from splatting.settings import Splatting


def make(initial: Initial, settings: Splatting) -> SplattingLearner:
    """A model that has seen no picture yet.

    Args:
        initial: what is known of the block.
        settings: `RELEASED`, `TUNED` or others.
    """
    return SplattingLearner(Gaussians(seeded(initial, settings.seeding), Look(settings.sh_degree)), settings)
