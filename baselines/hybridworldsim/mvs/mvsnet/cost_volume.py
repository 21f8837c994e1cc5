"""How much the features of all views differ, for every pixel and every plane of depth."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from hybridworldsim.mvs.learned.view import View

_PLANES_AT_ONCE = 8
_LEAST_EVIDENCE = 1e-3


def variance_volume(reference: Tensor, views: Sequence[View], depths_m: Tensor) -> Tensor:
    """The variance of features over the reference and all sources, by Welford's recurrence, a few planes at a time.

    What is outside a source counts as zero, as published; what is hidden in it does not count.

    Args:
        reference: (C, H, W).
        views: the sources.
        depths_m: (D,) of the planes.

    Returns:
        (C, D, H, W).
    """
    channels, rows, columns = reference.shape
    volume = torch.empty((channels, len(depths_m), rows, columns))
    for start in range(0, len(depths_m), _PLANES_AT_ONCE):
        depths = depths_m[start : start + _PLANES_AT_ONCE]
        planes = depths.view(-1, 1, 1).expand(-1, rows, columns)
        mean = reference[:, None].expand(-1, len(depths), -1, -1).clone()
        squares = torch.zeros_like(mean)
        count = torch.ones((len(depths), rows, columns))
        for view in views:
            seen, evidence = view.seen(planes)
            count = count + evidence
            warped = seen.div_(evidence.clamp(min=_LEAST_EVIDENCE))
            difference = warped - mean
            mean.addcmul_(difference, evidence / count)
            squares.addcmul_(difference, warped.sub_(mean).mul_(evidence))
        torch.div(squares, count, out=volume[:, start : start + len(depths)])
    return volume
