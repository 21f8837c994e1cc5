"""Losses of a rendered image."""

from __future__ import annotations

import torch
from torch import Tensor

from hybridworldsim.model.losses import colour_loss, depth_loss, structure_loss
from hybridworldsim.model.normal_loss import normal_loss
from hybridworldsim.trainable.training_image import TrainingImage
from mirror_baselines.splatting.appearance import FinishedImage
from mirror_baselines.splatting.settings import Weights

Weighted = dict[str, tuple[float, Tensor]]
_MIN_ALPHA = 0.5
_NEAREST_M, _FARTHEST_M = 0.1, 80.0


def image_losses(finished: FinishedImage, image: TrainingImage, weights: Weights) -> Weighted:
    """Return the losses of colours: weight and value by name; ``rgb``, the mean square error, is always present.

    Args:
        finished: the render.
        image: the training image.
        weights: weights of the losses.
    """
    scored, recorded = image.scored, image.rgb
    share = 1.0 - weights.structure
    losses: Weighted = {"rgb": (share, colour_loss(finished.rgb, recorded, scored))}
    if weights.pixelwise == "l1":
        losses["rgb"] = (0.0, losses["rgb"][1].detach())
        losses["l1"] = (share, _masked_mean((finished.rgb - recorded).abs().mean(2), scored))
    if weights.structure:
        losses["ssim"] = (weights.structure, structure_loss(finished.plain, recorded, scored))
    return losses


def surface_losses(
    depth_m: Tensor, alpha: Tensor, image: TrainingImage, weights: Weights, *, normals: bool
) -> Weighted:
    """Return the losses of depth and normals, where the dataset has depth.

    Args:
        depth_m: (H, W) expected depth.
        alpha: (H, W).
        image: the training image.
        weights: weights of the losses.
        normals: whether this step computes the normal loss.
    """
    losses: Weighted = {}
    if image.depth_m is None or not (weights.depth or weights.normal):
        return losses
    stereo = image.depth_m
    known = (stereo > 0.0) & image.scored & (alpha.detach() > _MIN_ALPHA)
    if weights.depth:
        if weights.depth_kind == "share":
            value = depth_loss(depth_m, stereo, known)
        else:
            is_in_range = known & (stereo > _NEAREST_M) & (stereo < _FARTHEST_M)
            rendered_m, stereo_m = depth_m.clamp_min(_NEAREST_M), stereo.clamp_min(_NEAREST_M)
            error = (
                rendered_m - stereo_m
                if weights.depth_kind == "metres"
                else rendered_m.reciprocal() - stereo_m.reciprocal()
            )
            value = _masked_mean(error.abs(), is_in_range)
        losses["depth"] = (weights.depth, value)
    if weights.normal and normals:
        value = normal_loss(depth_m, stereo, known, image.viewpoint.K)
        losses["normal"] = (weights.normal * weights.normal_every, value)
    return losses


def _masked_mean(values: Tensor, where: Tensor) -> Tensor:
    return torch.where(where, values, 0.0).sum() / where.sum().clamp_min(1)
