"""Losses of colour and depth as in the supplement ("Loss Function"), and a structure loss that the supplement lacks."""

from __future__ import annotations

import torch
from torch import Tensor

from hybridworldsim.model.ssim_loss import ssim


def colour_loss(rendered: Tensor, recorded: Tensor, scored: Tensor) -> Tensor:
    """Return the mean square error of the scored pixels.

    Args:
        rendered: (H, W, 3).
        recorded: (H, W, 3).
        scored: (H, W) bool, at least one pixel.
    """
    squares = (rendered - recorded).square().sum(2)
    return torch.where(scored, squares, 0.0).sum() / (3 * scored.sum())


def structure_loss(rendered: Tensor, recorded: Tensor, scored: Tensor) -> Tensor:
    """Return the mean of 1 - SSIM of the scored pixels.

    In the windows, a pixel that is not scored counts as rendered without error. 3DGS and Scaffold-GS have this loss,
    the supplement of HybridWorldSim does not: `Settings.structure_weight` is 0 for the paper's method.

    Args:
        rendered: (H, W, 3).
        recorded: (H, W, 3).
        scored: (H, W) bool.
    """
    filled = torch.where(scored[..., None], rendered, recorded)
    return 1.0 - torch.where(scored, ssim(filled, recorded), 0.0).sum() / scored.sum().clamp_min(1)


def depth_loss(rendered_m: Tensor, stereo_m: Tensor, known: Tensor) -> Tensor:
    """Return the mean square of the depth error as a share of the depth.

    With the supplement's square of metres, the farthest points make up nearly all of the loss, while the error of
    stereo grows at least in proportion to depth. The share is limited to 1, so that one wrong match has little effect.

    Args:
        rendered_m: (H, W) expected depth.
        stereo_m: (H, W) depth of multi-view stereo.
        known: (H, W) bool: pixels where the stereo depth is known.
    """
    share = (rendered_m - stereo_m) / stereo_m.clamp_min(1e-3)
    return torch.where(known, share.clamp(-1.0, 1.0).square(), 0.0).sum() / known.sum().clamp_min(1)
