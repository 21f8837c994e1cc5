"""Makes models of the OmniRe-style method."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from hybridworldsim.model.initialization import InitialGeometry
from hybridworldsim.trainable.viewpoint import Source
from mirror_baselines.omnire_style.appearance import AffineAppearance
from mirror_baselines.omnire_style.settings import OmnireStyle
from mirror_baselines.splatting.gaussian_init import initial_gaussians, no_gaussians
from mirror_baselines.splatting.model import Gaussians
from mirror_baselines.splatting.renderer import SplattingRenderer
from mirror_baselines.splatting.trainer import SplattingTrainer


def make(initial: InitialGeometry, settings: OmnireStyle) -> SplattingTrainer:
    """Make an untrained model; equal input and seed give an equal model.

    Args:
        initial: geometry of the block; its sources name the traversals and cameras.
        settings: `RELEASED`, `TUNED` or others.
    """
    appearance = _appearance(initial.sources, settings)
    return SplattingTrainer(Gaussians(initial_gaussians(initial, settings.seeding), appearance), settings)


def make_empty(sources: Sequence[Source], settings: OmnireStyle) -> SplattingRenderer:
    """Make a model without Gaussians, to render a trained model once its parameters are set.

    Args:
        sources: traversals and cameras of the training images.
        settings: settings of the training.
    """
    return SplattingRenderer(Gaussians(no_gaussians(), _appearance(sources, settings)), settings)


def _appearance(sources: Sequence[Source], settings: OmnireStyle) -> AffineAppearance:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        return AffineAppearance(sources, settings)
