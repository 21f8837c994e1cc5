"""Makes a trainer of the OmniRe-style method."""

from __future__ import annotations

import torch

from hybridworldsim.model.initialization import InitialGeometry
from mirror_baselines.omnire_style.appearance import AffineAppearance
from mirror_baselines.omnire_style.settings import OmnireStyle
from mirror_baselines.splatting.gaussian_init import initial_gaussians
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.trainer import SplattingTrainer


def make(initial: InitialGeometry, settings: OmnireStyle) -> SplattingTrainer:
    """Make an untrained model; equal input and seed give an equal model.

    Args:
        initial: geometry of the block; its sources name the traversals and cameras.
        settings: `RELEASED`, `TUNED` or others.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        appearance = AffineAppearance(initial.sources, settings)
    return SplattingTrainer(Gaussians(initial_gaussians(initial, settings.seeding), appearance), settings)
