"""Makes models of vanilla 3DGS."""

from __future__ import annotations

from collections.abc import Sequence

from hybridworldsim.model.initialization import InitialGeometry
from hybridworldsim.trainable.viewpoint import Source
from mirror_baselines.splatting.appearance import AppearanceModel
from mirror_baselines.splatting.gaussian_init import initial_gaussians, no_gaussians
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.renderer import SplattingRenderer
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


def make_empty(sources: Sequence[Source], settings: Splatting) -> SplattingRenderer:
    """Make a model without Gaussians, to render a trained model once its parameters are set.

    Args:
        sources: traversals and cameras of the training images.
        settings: settings of the training.
    """
    return SplattingRenderer(Gaussians(no_gaussians(), AppearanceModel(settings.sh_degree)), settings)
