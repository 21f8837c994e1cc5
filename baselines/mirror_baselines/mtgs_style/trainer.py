"""Makes models of the MTGS-style method."""

from __future__ import annotations

from collections.abc import Sequence

from hybridworldsim.model.initialization import InitialGeometry
from hybridworldsim.trainable.viewpoint import Source
from mirror_baselines.mtgs_style.appearance import TraversalAppearance
from mirror_baselines.mtgs_style.settings import MtgsStyle
from mirror_baselines.splatting.gaussian_init import initial_gaussians, no_gaussians
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.renderer import SplattingRenderer
from mirror_baselines.splatting.trainer import SplattingTrainer


def make(initial: InitialGeometry, settings: MtgsStyle) -> SplattingTrainer:
    """Make an untrained model.

    Args:
        initial: geometry of the block; its sources name the traversals.
        settings: `RELEASED`, `TUNED` or others.
    """
    appearance = _appearance(initial.sources, settings)
    return SplattingTrainer(Gaussians(initial_gaussians(initial, settings.seeding), appearance), settings)


def make_empty(sources: Sequence[Source], settings: MtgsStyle) -> SplattingRenderer:
    """Make a model without Gaussians, to render a trained model once its parameters are set.

    Args:
        sources: traversals and cameras of the training images.
        settings: settings of the training.
    """
    return SplattingRenderer(Gaussians(no_gaussians(), _appearance(sources, settings)), settings)


def _appearance(sources: Sequence[Source], settings: MtgsStyle) -> TraversalAppearance:
    return TraversalAppearance(
        settings.sh_degree, sources, adapters=settings.rates.adapter is not None, exposure=settings.exposure
    )
