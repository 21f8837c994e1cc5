"""What Gaussians before a depth cover of each pixel: channels that are blended as colours are."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor


def nearer_than(means: Tensor, viewmat: Tensor, limits_m: Sequence[float]) -> Tensor:
    """Mark the Gaussians with a centre before some depths.

    Gaussians are blended from front to back: the blended marks are the share of a pixel that those before a depth
    cover.

    Args:
        means: (N, 3) centres.
        viewmat: (4, 4) camera_SE3_world.
        limits_m: K depths (camera z).

    Returns:
        (N, K) 1 where the centre is nearer, else 0.
    """
    towards = viewmat[2].to(means.dtype)
    depth = means @ towards[:3] + towards[3]
    return (depth[:, None] < means.new_tensor(limits_m)).to(means.dtype)
