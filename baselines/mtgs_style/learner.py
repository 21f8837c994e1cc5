"""A learner of the MTGS-style method."""

from __future__ import annotations

from hybridworldsim.scene.seeding import Initial
from mtgs_style.look import TraversalLook
from mtgs_style.settings import MtgsStyle
from splatting.learner import SplattingLearner
from splatting.model import Gaussians
from splatting.seeding import seeded


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
