"""A learner of the OmniRe-style method."""

from __future__ import annotations

import torch

from hybridworldsim.model.initialization import InitialGeometry
from mirror_baselines.omnire_style.appearance import AffineAppearance
from mirror_baselines.omnire_style.settings import OmnireStyle
from mirror_baselines.splatting.gaussian_init import initial_gaussians
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.trainer import SplattingTrainer


def make(initial: InitialGeometry, settings: OmnireStyle) -> SplattingTrainer:
    """A model that has seen no image yet; the same for the same input and seed.

    Args:
        initial: what is known of the block; its sources say whose images are trained on.
        settings: `RELEASED`, `TUNED` or others.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        look = AffineAppearance(initial.sources, settings)
    return SplattingTrainer(Gaussians(initial_gaussians(initial, settings.seeding), look), settings)
