"""A few Gaussians in front of a small camera, for float64 gradients and edge cases."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from hybridworldsim.rasterizer.presets import PRESETS, GsplatPreset
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.reference import blend, project

WIDTH, HEIGHT = 21, 13
K = torch.tensor([[18.0, 0.0, 10.2], [0.0, 17.0, 6.1], [0.0, 0.0, 1.0]], dtype=torch.float64)
PRESET = PRESETS["gsplat-1.5"]


def gaussians(number: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> dict[str, Tensor]:
    """Random ones, 2 to 6 m ahead of a camera at the origin."""
    random = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=random, dtype=torch.float64)

    z = 2.0 + 4.0 * uniform(number)
    means = torch.stack([(uniform(number) - 0.5) * z, (uniform(number) - 0.5) * 0.7 * z, z], dim=-1)
    return {
        "means": means.to(dtype),
        "quats": (uniform(number, 4) - 0.5).to(dtype),
        "scales": (0.05 + 0.4 * uniform(number, 3)).to(dtype),
        "opacities": (0.2 + 0.7 * uniform(number)).to(dtype),
    }


def project_small(
    means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, viewmat: Tensor | None = None, **options: Any
) -> ProjectedGaussians:
    """`project` with gsplat's defaults."""
    defaults = {
        "eps2d": 0.3, "near_plane": 0.01, "far_plane": 1e10, "radius_clip": 0.0, "preset": PRESET, "antialiased": False,
        "lens": None,
    }  # fmt: skip
    camera = torch.eye(4, dtype=torch.float64) if viewmat is None else viewmat
    intrinsics = options.pop("K", K)
    size = options.pop("width", WIDTH), options.pop("height", HEIGHT)
    return project(means, quats, scales, opacities, camera, intrinsics, *size, **{**defaults, **options})


def render_image(
    scene: dict[str, Tensor], features: Tensor, *, preset: GsplatPreset = PRESET, tile_size: int = 16, **options: Any
) -> tuple[Tensor, Tensor, ProjectedGaussians]:
    """Image, alpha and what was projected."""
    size = options.get("width", WIDTH), options.get("height", HEIGHT)
    seen = project_small(**scene, preset=preset, **options)
    opacities = scene["opacities"][seen.ids]
    if seen.compensations is not None:
        opacities = opacities * seen.compensations
    blended = blend(seen, features[seen.ids], opacities, *size, preset=preset, tile_size=tile_size, absgrad=False)
    return blended.image, blended.alpha, seen
