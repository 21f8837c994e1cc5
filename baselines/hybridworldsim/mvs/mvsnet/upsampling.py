"""Upsamples depth maps and confidences from the size of the features to the size of the image."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

_MAX_DEPTH_RATIO = 1.1


def upsample_depth(depth_m: Tensor, stride: int) -> Tensor:
    """Compute the depth of each pixel from samples.

    Sample i is the depth of pixel ``stride i``. Between samples inverse depth is interpolated bilinearly, which is
    exact on a plane. Where the four samples around a pixel differ by more than a tenth, the pixel takes the nearest
    one, so that no surface appears between two others.

    Args:
        depth_m: (H, W).
        stride: pixels between samples.

    Returns:
        (stride H, stride W); pixels after the last sample take its depth.
    """
    rows, columns = depth_m.shape
    row = (torch.arange(rows * stride, device=depth_m.device) / stride).clamp_(max=rows - 1)
    column = (torch.arange(columns * stride, device=depth_m.device) / stride).clamp_(max=columns - 1)
    top, left = row.floor().long(), column.floor().long()
    bottom, right = (top + 1).clamp_(max=rows - 1), (left + 1).clamp_(max=columns - 1)
    down, across = (row - top)[:, None], (column - left)[None]
    corners = [depth_m[v][:, u] for v in (top, bottom) for u in (left, right)]
    inverse = [corner.reciprocal() for corner in corners]
    upper = inverse[0] + across * (inverse[1] - inverse[0])
    lower = inverse[2] + across * (inverse[3] - inverse[2])
    smooth = (upper + down * (lower - upper)).reciprocal()
    stack = torch.stack(corners)
    nearest = depth_m[row.round().long()][:, column.round().long()]
    return torch.where(stack.amax(0) <= _MAX_DEPTH_RATIO * stack.amin(0), smooth, nearest)


def repeat_samples(values: Tensor, stride: int) -> Tensor:
    """Repeat values (H, W) to (stride H, stride W): each pixel takes the value of its block."""
    return functional.interpolate(values[None, None], scale_factor=float(stride), mode="nearest")[0, 0]
