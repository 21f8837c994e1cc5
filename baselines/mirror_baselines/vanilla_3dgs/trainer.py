"""Makes a trainer of vanilla 3DGS."""

from __future__ import annotations

from hybridworldsim.model.initialization import InitialGeometry
from mirror_baselines.splatting.appearance import AppearanceModel
from mirror_baselines.splatting.gaussian_init import initial_gaussians
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.settings import Splatting
from mirror_baselines.splatting.trainer import SplattingTrainer


def make(initial: InitialGeometry, settings: Splatting) -> SplattingTrainer:
    """Make an untrained model.

    Args:
        initial: geometry of the block.
        settings: `RELEASED`, `TUNED` or others.
    """
    return SplattingTrainer(
        Gaussians(initial_gaussians(initial, settings.seeding), AppearanceModel(settings.sh_degree)), settings
    )
