"""Random Gaussians before a camera, and comparisons of their projections."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from hybridworldsim.rasterizer.presets import get_preset
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians

Inputs = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]


def options(preset: str = "gsplat-1.5", antialiased: bool = False, **others: float) -> dict[str, Any]:
    limits = {"eps2d": 0.3, "near_plane": 0.01, "far_plane": 15.0, "radius_clip": 0.0} | others
    return limits | {"preset": get_preset(preset), "antialiased": antialiased, "lens": None}


def default_view() -> Tensor:
    """A pose without a zero in its rotation."""
    viewmat = torch.eye(4, dtype=torch.float64)
    generator = torch.tensor([[0.0, -0.07, 0.3], [0.07, 0.0, -0.11], [-0.3, 0.11, 0.0]], dtype=torch.float64)
    viewmat[:3, :3] = torch.linalg.matrix_exp(generator)
    viewmat[:3, 3] = torch.tensor([0.1, -0.2, 0.5])
    return viewmat


def random_gaussians(number: int, *, aspect: float = 1.0, seed: int = 0, dtype: torch.dtype = torch.float32) -> Inputs:
    """Gaussians around the camera, of which about a quarter is seen."""
    random = torch.Generator().manual_seed(seed)
    means = (2.0 * torch.rand(number, 3, generator=random) - 1.0) * torch.tensor([10.0, 6.0, 10.0])
    means[:, 2] += 10.0
    scales = torch.exp(0.5 * torch.randn(number, 3, generator=random) - 3.0)
    scales[:, 0] *= aspect
    quats = 3.0 * torch.randn(number, 4, generator=random)
    opacities = torch.rand(number, generator=random)
    return means.to(dtype), quats.to(dtype), scales.to(dtype), opacities.to(dtype), default_view()


def leaves(inputs: Inputs) -> Inputs:
    means, quats, scales, opacities, viewmat = (tensor.clone() for tensor in inputs)
    return *(t.requires_grad_() for t in (means, quats, scales)), opacities, viewmat.requires_grad_()


def gradients(projected: ProjectedGaussians, inputs: Inputs, seed: int = 1) -> list[Tensor]:
    random = torch.Generator().manual_seed(seed)
    shown = [projected.means2d, projected.depths, 100.0 * projected.conics]
    if projected.compensations is not None:
        shown.append(10.0 * projected.compensations)
    weights = [torch.randn(tensor.shape, generator=random, dtype=torch.float64) for tensor in shown]
    total = sum((tensor.double() * weight).sum() for tensor, weight in zip(shown, weights))
    return list(torch.autograd.grad(total, (*inputs[:3], inputs[4])))


def distance(ours: Tensor, truth: Tensor) -> float:
    return float(((ours.double() - truth).norm(dim=-1) / truth.norm(dim=-1)).detach().max())
