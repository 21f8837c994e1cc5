"""Makes a trainer of the MTGS-style method."""

from __future__ import annotations

from hybridworldsim.model.initialization import InitialGeometry
from mirror_baselines.mtgs_style.appearance import TraversalAppearance
from mirror_baselines.mtgs_style.settings import MtgsStyle
from mirror_baselines.splatting.gaussian_init import initial_gaussians
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.trainer import SplattingTrainer


def make(initial: InitialGeometry, settings: MtgsStyle) -> SplattingTrainer:
    """Make an untrained model.

    Args:
        initial: geometry of the block; its sources name the traversals.
        settings: `RELEASED`, `TUNED` or others.
    """
    appearance = TraversalAppearance(
        settings.sh_degree,
        initial.sources,
        adapters=settings.rates.adapter is not None,
        exposure=settings.exposure,
    )
    return SplattingTrainer(Gaussians(initial_gaussians(initial, settings.seeding), appearance), settings)
