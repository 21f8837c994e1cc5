"""Losses of colour and depth, as the supplement has them ("Loss Function"), and of structure, which it has not."""

from __future__ import annotations

import torch
from torch import Tensor

from hybridworldsim.model.ssim_loss import ssim


def colour_loss(rendered: Tensor, taken: Tensor, scored: Tensor) -> Tensor:
    """Mean square error of the pixels that are scored.

    Args:
        rendered: (H, W, 3).
        taken: (H, W, 3).
        scored: (H, W) bool, at least one pixel.
    """
    squares = (rendered - taken).square().sum(2)
    return torch.where(scored, squares, 0.0).sum() / (3 * scored.sum())


def structure_loss(rendered: Tensor, taken: Tensor, scored: Tensor) -> Tensor:
    """Mean of 1 - SSIM of the pixels that are scored, in whose windows all others are as they should be.

    3DGS and Scaffold-GS have it, the supplement of HybridWorldSim does not: `Settings.structure_weight` is 0 for the
    paper's method.

    Args:
        rendered: (H, W, 3).
        taken: (H, W, 3).
        scored: (H, W) bool.
    """
    filled = torch.where(scored[..., None], rendered, taken)
    return 1.0 - torch.where(scored, ssim(filled, taken), 0.0).sum() / scored.sum().clamp_min(1)


def depth_loss(rendered_m: Tensor, stereo_m: Tensor, known: Tensor) -> Tensor:
    """Mean square of the depth's error as a share of the depth.

    The supplement's plain square metres are all but those of the farthest points; stereo errs in proportion to depth
    at least. An error counts as no more than the depth itself, so that one wrong match moves nothing.

    Args:
        rendered_m: (H, W) expected depth.
        stereo_m: (H, W) depth of multi-view stereo.
        known: (H, W) bool: where there is one.
    """
    share = (rendered_m - stereo_m) / stereo_m.clamp_min(1e-3)
    return torch.where(known, share.clamp(-1.0, 1.0).square(), 0.0).sum() / known.sum().clamp_min(1)
