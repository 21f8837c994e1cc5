"""The loss: quality focal loss (X. Li et al., 2020) and generalised overlap of boxes (H. Rezatofighi et al., 2019)."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

from benchmarks.plates.training.network import decode

_SPANS_PX: Final = {8: (0.0, 76.0), 16: (48.0, 176.0), 32: (112.0, 384.0), 64: (256.0, 1e9)}
"""Widths of the plates that cells of a stride find; a plate of two rows counts as 1.6 times its height."""
_SHARE: Final = 0.22
_LEAST: Final = 0.7
_BOX_WEIGHT: Final = 2.0


def plate_loss(
    raw: Tensor, cells: Tensor, boxes: Tensor, is_plate: Tensor, is_ignored: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the losses of scores and of boxes.

    Args:
        raw: (B, N, 5) outputs.
        cells: (N, 3) middle and stride.
        boxes: (B, M, 4) true boxes, padded.
        is_plate: (B, M) which are sought.
        is_ignored: (B, M) which are neither sought nor refused.
    """
    with torch.no_grad():
        owner, is_near, is_left_out = assign(cells, boxes, is_plate, is_ignored)
    predicted = decode(raw.float(), cells)
    target = torch.gather(boxes, 1, owner[..., None].expand(-1, -1, 4))
    logits = raw[..., 4].float()
    number = is_near.sum().clamp(min=1).float()
    common, generalised = overlaps(predicted[is_near], target[is_near])
    box_loss = (1.0 - generalised).sum() / number
    quality = torch.zeros_like(logits)
    quality[is_near] = common.detach().clamp(0.0, 1.0)
    focal = (logits.sigmoid() - quality).abs() ** 2
    entropy = functional.binary_cross_entropy_with_logits(logits, quality, reduction="none")
    score_loss = (focal * entropy * (is_near | ~is_left_out)).sum() / number
    return score_loss, _BOX_WEIGHT * box_loss


def assign(cells: Tensor, boxes: Tensor, is_plate: Tensor, is_ignored: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Assign plates to cells: those near its middle whose stride fits its width.

    Returns:
        The plate (B, N) of each cell, whether the cell finds one (B, N), and whether it lies at one that is ignored.
    """
    size = boxes[..., 2:] - boxes[..., :2]
    middle = 0.5 * (boxes[..., 2:] + boxes[..., :2])
    width = torch.maximum(size[..., 0], 1.6 * size[..., 1])
    stride = cells[:, 2]
    spans = torch.tensor([_SPANS_PX[int(one)] for one in stride.unique(sorted=True)], device=cells.device)
    own = spans[torch.bucketize(stride, stride.unique(sorted=True))]
    fits = (width[:, None] >= own[None, :, :1]) & (width[:, None] < own[None, :, 1:])
    away = (cells[None, :, None, :2] - middle[:, None]).abs()
    reach = torch.maximum(_SHARE * size[:, None], _LEAST * stride[None, :, None, None])
    near = (away <= reach).all(dim=-1) & fits & is_plate[:, None]
    distance = torch.where(near, (away / reach).amax(dim=-1), torch.full_like(away[..., 0], torch.inf))
    least, owner = distance.min(dim=-1)
    inside = (away <= 0.5 * size[:, None] + stride[None, :, None, None]).all(dim=-1)
    left_out = (inside & is_ignored[:, None]).any(dim=-1)
    return owner, torch.isfinite(least), left_out


def overlaps(first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """Return the intersection over union (N,) of pairs of boxes (N, 4), and the generalised one."""
    low, high = torch.maximum(first[:, :2], second[:, :2]), torch.minimum(first[:, 2:], second[:, 2:])
    common = (high - low).clamp(min=0).prod(dim=-1)
    areas = [(one[:, 2:] - one[:, :2]).clamp(min=0).prod(dim=-1) for one in (first, second)]
    union = areas[0] + areas[1] - common
    hull = (torch.maximum(first[:, 2:], second[:, 2:]) - torch.minimum(first[:, :2], second[:, :2])).prod(dim=-1)
    share = common / union.clamp(min=1e-6)
    return share, share - (hull - union) / hull.clamp(min=1e-6)
