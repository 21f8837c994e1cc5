"""Colours of Gaussians in the direction of a camera: what lies before and after the sum of spherical harmonics."""

from __future__ import annotations

import torch
from torch import Tensor


def compute_directions(means: Tensor, viewmat: Tensor) -> Tensor:
    """Compute directions (N, 3) from a camera to Gaussians; they are exact far from the origin.

    The camera position is a sum of two numbers of the means' dtype.

    Args:
        means: (N, 3) centres.
        viewmat: (4, 4) camera from world.
    """
    pose = viewmat.double()
    position = -torch.linalg.solve(pose[:3, :3], pose[:3, 3])
    rounded = position.to(means.dtype)
    return means - rounded - (position - rounded).to(means.dtype)


def to_colours(sums: Tensor) -> Tensor:
    """Convert sums (N, 3) of spherical harmonics to colours, as Gaussian splatting does."""
    return (sums + 0.5).clamp_min(0.0)
