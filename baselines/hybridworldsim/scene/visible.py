"""Which points a viewpoint may see, so that nothing else is decoded."""

from __future__ import annotations

import torch
from torch import Tensor

from hybridworldsim.training.viewpoint import Viewpoint

NEAREST_M = 0.05


def visible(viewpoint: Viewpoint, means: Tensor, reach_m: Tensor) -> Tensor:
    """Points whose sphere the view's pyramid may meet.

    Args:
        viewpoint: whence.
        means: (N, 3) in the block's frame.
        reach_m: (N,) radius of what belongs to each.

    Returns:
        (M,) int64 rows, ascending.
    """
    with torch.no_grad():
        x, y, z = (means @ viewpoint.viewmat[:3, :3].T + viewpoint.viewmat[:3, 3]).unbind(1)
        seen = z + reach_m > NEAREST_M
        K, width, height = viewpoint.K, viewpoint.width_px, viewpoint.height_px
        for along, focal, centre, size in ((x, K[0, 0], K[0, 2], width), (y, K[1, 1], K[1, 2], height)):
            # The two planes of this side, their normals' lengths taken into the reach.
            low, high = float(centre / focal), float((size - centre) / focal)
            seen &= along + low * z > -reach_m * (1.0 + low * low) ** 0.5
            seen &= high * z - along > -reach_m * (1.0 + high * high) ** 0.5
        return seen.nonzero().squeeze(1)


def unit(vectors: Tensor) -> Tensor:
    """Vectors (N, 3) at length 1; those of no length stay as they are."""
    # Torch's norms along an axis of three are several times slower.
    x, y, z = vectors.unbind(1)
    return vectors * (x * x + y * y + z * z).clamp_min(1e-24).rsqrt()[:, None]
