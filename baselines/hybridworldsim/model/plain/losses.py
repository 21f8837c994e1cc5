"""Losses in plain torch, on complete images of any precision and on any device."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from hybridworldsim.model.plain.decoding import blur


def compute_normals(depth_m: Tensor, K: Tensor) -> Tensor:
    """Return the unit normals (H, W, 3) of a depth map, in the camera's frame, towards the camera.

    Args:
        depth_m: (H, W) camera z, positive.
        K: (3, 3).
    """
    height, width = depth_m.shape
    x = (torch.arange(width, dtype=depth_m.dtype, device=depth_m.device) + 0.5 - K[0, 2]) / K[0, 0]
    y = (torch.arange(height, dtype=depth_m.dtype, device=depth_m.device) + 0.5 - K[1, 2]) / K[1, 1]
    points = torch.stack((x * depth_m, y[:, None] * depth_m, depth_m))
    padded = functional.pad(points, (1, 1, 1, 1), mode="replicate")
    right = padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2]
    down = padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]
    across = torch.linalg.cross(down, right, dim=0)
    # Torch's norms along an axis of three are many times slower.
    return (across * across.square().sum(0).clamp_min(1e-24).rsqrt()).permute(1, 2, 0)


def curvature(normals: Tensor) -> Tensor:
    """Compute the curvature (H - 2, W - 2) of a map of normals (H, W, 3).

    It is the sum of squared Sobel gradients over channels and directions.
    """
    # Sobel's kernels are a smoothing one way and a difference the other; sums of slices are far faster than torch's
    # convolutions of three channels, backwards above all.
    down = normals[:-2] + 2.0 * normals[1:-1] + normals[2:]
    across = normals[:, :-2] + 2.0 * normals[:, 1:-1] + normals[:, 2:]
    return (down[:, 2:] - down[:, :-2]).square().sum(2) + (across[2:] - across[:-2]).square().sum(2)


def normal_loss(rendered_m: Tensor, stereo_m: Tensor, known: Tensor, K: Tensor) -> Tensor:
    """Compute the mean absolute difference of curvatures.

    It is that of pixels where all nine depths exist and a curvature can be computed.

    Args:
        rendered_m: (H, W) expected depth.
        stereo_m: (H, W) depth of multi-view stereo; its normals are computed from it.
        known: (H, W) bool.
        K: (3, 3).
    """
    filled = torch.where(known, stereo_m, 1.0)
    # A normal needs four neighbours, and a gradient needs eight normals.
    whole = _neighbours(_neighbours(functional.pad(known, (1, 1, 1, 1), value=True)).T).T
    with torch.no_grad():
        target = curvature(compute_normals(filled, K))
    found = curvature(compute_normals(rendered_m.clamp_min(1e-3), K))
    return torch.where(whole, (found - target).abs(), 0.0).sum() / whole.sum().clamp_min(1)


def _neighbours(known: Tensor) -> Tensor:
    """(H - 4, W) whether a mask (H, W) is set in all five rows around."""
    rows = max(len(known) - 4, 0)
    return known[:rows] & known[1 : rows + 1] & known[2 : rows + 2] & known[3 : rows + 3] & known[4:]


def structural_similarity(x: Tensor, y: Tensor) -> Tensor:
    """Return the structural similarity (H, W) of images (H, W, 3), averaged over the channels, black beyond the border.

    Source: Wang et al. 2004, windows of 11 x 11, sigma 1.5.
    """
    steps = torch.arange(-5, 6, dtype=x.dtype, device=x.device)
    window = torch.exp(-(steps**2) / (2.0 * 1.5**2))
    window = window / window.sum()
    mean_x, mean_y = blur(x, window), blur(y, window)
    xx, yy, xy = blur(x * x, window) - mean_x**2, blur(y * y, window) - mean_y**2, blur(x * y, window) - mean_x * mean_y
    ssim = (2 * mean_x * mean_y + 1e-4) * (2 * xy + 9e-4) / ((mean_x**2 + mean_y**2 + 1e-4) * (xx + yy + 9e-4))
    return ssim.mean(2)
