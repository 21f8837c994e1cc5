"""The cost volume: how much the features of all images differ, for each pixel and each depth plane."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from hybridworldsim.mvs.learned.source_features import SourceFeatures

_PLANE_BATCH = 8
_MIN_EVIDENCE = 1e-3


def compute_variance_volume(reference: Tensor, sources: Sequence[SourceFeatures], depths_m: Tensor) -> Tensor:
    """Compute the variance of features over the reference and all sources, by Welford's recurrence.

    Samples outside a source count as zero, as published; hidden samples of a source do not count. A few planes are
    computed at a time.

    Args:
        reference: (C, H, W) features.
        sources: features of the sources.
        depths_m: (D,) depths of the planes.

    Returns:
        (C, D, H, W).
    """
    channels, rows, columns = reference.shape
    volume = torch.empty((channels, len(depths_m), rows, columns), device=reference.device)
    for start in range(0, len(depths_m), _PLANE_BATCH):
        depths = depths_m[start : start + _PLANE_BATCH]
        planes = depths.view(-1, 1, 1).expand(-1, rows, columns)
        mean = reference[:, None].expand(-1, len(depths), -1, -1).clone()
        squares = torch.zeros_like(mean)
        count = torch.ones((len(depths), rows, columns), device=reference.device)
        for source in sources:
            features, evidence = source.warp(planes)
            count = count + evidence
            warped = features.div_(evidence.clamp(min=_MIN_EVIDENCE))
            difference = warped - mean
            mean.addcmul_(difference, evidence / count)
            squares.addcmul_(difference, warped.sub_(mean).mul_(evidence))
        torch.div(squares, count, out=volume[:, start : start + len(depths)])
    return volume
