"""Initial Gaussians: points of the background, the ground and the sky, at the places where a street has them."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from hybridworldsim.model.initialization import (
    InitialGeometry,
    background_points,
    ground_seeds,
    neighbour_spacing,
    sky_seeds,
)
from hybridworldsim.model.nodes.code_gaussians import Seeds
from mirror_baselines.splatting.settings import GaussianInit

_BAND0 = 0.28209479177387814
_GREY = 0.5


def initial_gaussians(initial: InitialGeometry, settings: GaussianInit) -> dict[str, Tensor]:
    """Compute the initial parameters of explicit Gaussians, named as in gsplat's strategies.

    Args:
        initial: geometry of the block.
        settings: counts and spacings.

    Returns:
        ``means`` (N, 3) metres, ``quats`` (N, 4), ``scales`` (N, 3) logarithms, ``opacities`` (N,) logits and the
        constant band ``sh0`` (N, 1, 3).
    """
    ground = ground_seeds(initial, settings.ground_spacing_m, settings.ground_reach_m)
    sky = _sky(initial, settings)
    points, colours = _background(initial, settings)
    parts = (points, ground, sky)
    opacities = [torch.full((len(part.means),), part.opacity) for part in parts]
    grey = [torch.full_like(part.means, _GREY) for part in (ground, sky)]
    return {
        "means": torch.cat([part.means for part in parts]),
        "quats": torch.cat([part.quats for part in parts]),
        "scales": torch.cat([part.scales for part in parts]).log(),
        "opacities": torch.cat(opacities).logit(),
        "sh0": ((torch.cat([colours, *grey]) - 0.5) / _BAND0)[:, None],
    }


def no_gaussians() -> dict[str, Tensor]:
    """Return the parameters that `initial_gaussians` returns, for zero Gaussians."""
    shapes = {"means": (0, 3), "quats": (0, 4), "scales": (0, 3), "opacities": (0,), "sh0": (0, 1, 3)}
    return {name: torch.empty(shape) for name, shape in shapes.items()}


def _sky(initial: InitialGeometry, settings: GaussianInit) -> Seeds:
    count = settings.sky_count
    seeds = sky_seeds(initial, max(count, 1), settings.sky_radii, settings.far_count)
    if count:
        return seeds
    # A method without sky Gaussians keeps only the points beyond the block.
    return Seeds(seeds.means[1:], seeds.quats[1:], seeds.scales[1:], seeds.opacity)


def _background(initial: InitialGeometry, settings: GaussianInit) -> tuple[Seeds, Tensor]:
    points = background_points(initial, settings.spacing_m, settings.share, settings.most)
    sizes = settings.size * neighbour_spacing(points, settings.spacing_m)
    colours = np.full((len(points), 3), _GREY)
    if initial.points_rgb is not None and len(points):
        _, rows = cKDTree(initial.points_m).query(points)
        colours = initial.points_rgb[rows] / 255.0
    quats = torch.zeros(len(points), 4)
    quats[:, 0] = 1.0
    seeds = Seeds(
        torch.from_numpy(points.astype(np.float32)),
        quats,
        torch.from_numpy(np.repeat(sizes[:, None], 3, axis=1).astype(np.float32)),
        settings.opacity,
    )
    return seeds, torch.from_numpy(colours.astype(np.float32))
