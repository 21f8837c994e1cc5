"""Weights of overlapping blocks at a place; they sum to one everywhere."""

from __future__ import annotations

import torch
from torch import Tensor


def partition(places: Tensor, centres: Tensor, ramp_m: float) -> Tensor:
    """Compute smooth weights of blocks: 1 in a block's own area, falling to 0 across strips shared with neighbours.

    Between two blocks the weight depends on the signed distance to the line midway between their centres, and is one
    half on it; with several blocks the products are normalised. The weights are smooth, so that nothing jumps where a
    camera or a Gaussian crosses from one block to the next.

    Args:
        places: (N, 2).
        centres: (B, 2) in the same frame, metres.
        ramp_m: width of a strip.

    Returns:
        (N, B) in [0, 1]; rows sum to one.
    """
    if len(centres) == 1:
        return torch.ones(len(places), 1, dtype=places.dtype)
    offsets = centres[None] - centres[:, None]
    distances = offsets.norm(dim=2)
    midpoints = (centres[None] + centres[:, None]) / 2.0
    weights = torch.ones(len(places), len(centres), dtype=places.dtype)
    for block in range(len(centres)):
        others = (distances[block] > 0.0).nonzero().squeeze(1)
        normals = offsets[block, others] / distances[block, others, None]
        # Distance beyond the midway line, in widths of the strip.
        beyond = (places @ normals.T - (midpoints[block, others] * normals).sum(1)) / max(ramp_m, 1e-6)
        weights[:, block] = smoothstep(0.5 - beyond).prod(1)
    return weights / weights.sum(1, keepdim=True)


def smoothstep(share: Tensor) -> Tensor:
    """Return a smooth cubic from 0 at 0 to 1 at 1, constant outside; its values at t and 1 - t sum to one."""
    share = share.clamp(0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)
