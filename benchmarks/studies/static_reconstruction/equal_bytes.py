"""Settings of baselines with as many bytes as our model."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import torch

from hybridworldsim.model.nodes.anchors import Anchors
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians, Seeds
from hybridworldsim.model.settings import Settings
from mirror_baselines.mtgs_style import MtgsStyle
from mirror_baselines.omnire_style import OmnireStyle
from mirror_baselines.splatting.settings import Splatting

_GEOMETRY: Final = 11
"""Numbers of a Gaussian that are not colour: place, rotation, scale, opacity."""
_TRAVERSALS: Final = 4
"""Training traversals of a declared scene."""


def with_equal_bytes(settings: Splatting) -> Splatting:
    """Return a baseline's settings with as many Gaussians as fill the bytes of our model in single precision."""
    bands = 3 * (settings.sh_degree + 1) ** 2
    if isinstance(settings, MtgsStyle):
        # A constant band for all, and a set of all bands for each of the four traversals of a scene.
        each, fixed = _GEOMETRY + 3 + _TRAVERSALS * bands, 0
    elif isinstance(settings, OmnireStyle):
        each, fixed = _GEOMETRY + bands, 6 * 3 * settings.sky_px**2
    else:
        each, fixed = _GEOMETRY + bands, 0
    most = (count_parameters(Settings()) - fixed) // each
    seeding = replace(settings.seeding, most=min(settings.seeding.most, most // 2))
    return replace(settings, seeding=seeding, densification=replace(settings.densification, most=most))


def count_parameters(settings: Settings) -> int:
    """Return the number of parameters of our model of a block at its largest."""
    sizes = {"code": settings.code, "latent": settings.latent, "hidden": settings.hidden}
    none = torch.empty(0, 3)
    anchors = Anchors(none, torch.empty(0), 1.0, offsets=settings.offsets, **sizes)
    seeds = Seeds(none, torch.empty(0, 4), none, 0.5)
    plain = CodeGaussians(seeds, settings.plain_code, settings.latent, settings.hidden)
    refinement = settings.refinement
    numbers = 0
    for node, most in (
        (anchors, refinement.max_anchors),
        (plain, refinement.most_ground),
        (plain, refinement.most_sky),
    ):
        for parameter in node.parameters():
            # Tables with a row a Gaussian have none yet.
            rows = most if len(parameter) == 0 else len(parameter)
            numbers += rows * math.prod(parameter.shape[1:])
    return numbers
