"""A depth map at a quarter of a picture's size, brought to its whole size."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

_ONE_SURFACE = 1.1


def enlarged(depth_m: Tensor, stride: int) -> Tensor:
    """Depth of every pixel.

    Sample i is the depth of pixel ``stride i``. Between samples inverse depth is bilinear, as it is on a plane; where
    the four samples about a pixel differ by more than a tenth, it takes the nearest one, so that no surface appears
    between two others.

    Args:
        depth_m: (H, W).
        stride: pixels from sample to sample.

    Returns:
        (stride H, stride W); beyond the last sample its depth goes on.
    """
    rows, columns = depth_m.shape
    place_v = (torch.arange(rows * stride) / stride).clamp_(max=rows - 1)
    place_u = (torch.arange(columns * stride) / stride).clamp_(max=columns - 1)
    top, left = place_v.floor().long(), place_u.floor().long()
    bottom, right = (top + 1).clamp_(max=rows - 1), (left + 1).clamp_(max=columns - 1)
    down, across = (place_v - top)[:, None], (place_u - left)[None]
    corners = [depth_m[v][:, u] for v in (top, bottom) for u in (left, right)]
    inverse = [corner.reciprocal() for corner in corners]
    upper = inverse[0] + across * (inverse[1] - inverse[0])
    lower = inverse[2] + across * (inverse[3] - inverse[2])
    smooth = (upper + down * (lower - upper)).reciprocal()
    stack = torch.stack(corners)
    nearest = depth_m[place_v.round().long()][:, place_u.round().long()]
    return torch.where(stack.amax(0) <= _ONE_SURFACE * stack.amin(0), smooth, nearest)


def repeated(values: Tensor, stride: int) -> Tensor:
    """(stride H, stride W): values (H, W) of the nearest sample to the left and above."""
    return functional.interpolate(values[None, None], scale_factor=float(stride), mode="nearest")[0, 0]
