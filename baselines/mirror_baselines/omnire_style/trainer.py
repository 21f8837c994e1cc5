"""A learner of the OmniRe-style method."""

from __future__ import annotations

import torch

from hybridworldsim.model.initialization import Initial
from mirror_baselines.omnire_style.appearance import AffineLook
from mirror_baselines.omnire_style.settings import OmnireStyle
from mirror_baselines.splatting.gaussian_init import seeded
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.trainer import SplattingLearner


def make(initial: Initial, settings: OmnireStyle) -> SplattingLearner:
    """A model that has seen no picture yet; the same for the same input and seed.

    Args:
        initial: what is known of the block; its sources say whose pictures are trained on.
        settings: `RELEASED`, `TUNED` or others.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        look = AffineLook(initial.sources, settings)
    return SplattingLearner(Gaussians(seeded(initial, settings.seeding), look), settings)
