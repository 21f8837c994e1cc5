"""Whose a place is, where blocks overlap: weights of the blocks that sum to one everywhere."""

from __future__ import annotations

import torch
from torch import Tensor


def partition(places: Tensor, centres: Tensor, ramp_m: float) -> Tensor:
    """Smooth weights of blocks: 1 in a block's own part, falling to 0 across the strips that it shares.

    Between two blocks the weight goes with the signed distance to the line midway between their centres, and is a half
    there; of several the products are normalised. The weights are smooth, so that nothing jumps where a camera
    or a Gaussian crosses from one block to the next.

    Args:
        places: (N, 2).
        centres: (B, 2) in the same frame, metres.
        ramp_m: width of a strip.

    Returns:
        (N, B) in [0, 1]; rows sum to one.
    """
    between = centres[None] - centres[:, None]
    apart = between.norm(dim=2)
    middle = (centres[None] + centres[:, None]) / 2.0
    own = torch.ones(len(places), len(centres), dtype=places.dtype)
    for block in range(len(centres)):
        others = (apart[block] > 0.0).nonzero().squeeze(1)
        normals = between[block, others] / apart[block, others, None]
        # Beyond the line midway, in widths of the strip.
        beyond = (places @ normals.T - (middle[block, others] * normals).sum(1)) / max(ramp_m, 1e-6)
        own[:, block] = smooth(0.5 - beyond).prod(1)
    return own / own.sum(1, keepdim=True)


def smooth(share: Tensor) -> Tensor:
    """A cubic without a kink from 0 at 0 to 1 at 1, constant beyond; that of t and that of 1 - t sum to one."""
    share = share.clamp(0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)
