"""Makes posed images of scenes with known depth."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from hybridworldsim.mvs.estimator import StereoImage
from hybridworldsim.mvs.learned.layers import fold_norms
from mirror.geometry.poses import Poses


def make_intrinsics(width, height, focal=None):
    focal = focal or 0.8 * width
    return np.array([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])


def make_stereo_image(rgb, translation=(0.0, 0.0, 0.0), rotation=(1.0, 0.0, 0.0, 0.0), valid=None, K=None):
    height, width = rgb.shape[:2]
    pose = Poses(np.array([rotation], float), np.array([translation], float))
    K = make_intrinsics(width, height) if K is None else K
    return StereoImage(rgb, K, pose, np.ones((height, width), bool) if valid is None else valid)


def make_wall_image(
    width, height, translation=(0.0, 0.0, 0.0), normal=(0.2, -0.1, -1.0), distance_m=8.0, world=(0.0, 0.0, 0.0)
):
    """Make an image of a slanted wall with a smooth pattern, and its exact depth.

    The camera is at ``world + translation`` and faces along z; the wall is the plane ``normal . X = -distance_m``
    relative to ``world``.
    """
    K = make_intrinsics(width, height)
    v, u = np.meshgrid(np.arange(height) + 0.5, np.arange(width) + 0.5, indexing="ij")
    ray = np.stack((u, v, np.ones_like(u)), axis=-1) @ np.linalg.inv(K).T
    centre, unit = np.asarray(translation, float), np.asarray(normal, float) / np.linalg.norm(normal)
    depth = (-distance_m - centre @ unit) / (ray @ unit)
    x, y, _ = np.moveaxis(centre + depth[..., None] * ray, -1, 0)
    waves = [np.sin(a * x + b * y + c) for a, b, c in ((3, 1, 0), (-2, 5, 1), (7, 3, 2), (4, -9, 3), (13, 11, 4))]
    bands = np.stack([sum(waves[:3]), sum(waves[1:4]), sum(waves[2:])], axis=-1)
    rgb = np.clip(127.5 + 40.0 * bands, 0, 255).astype(np.uint8)
    return make_stereo_image(rgb, np.asarray(world) + centre, K=K), depth


def randomise(network: nn.Module, seed: int) -> nn.Module:
    """Fill all tensors of a network, statistics included, with random values; switch it to evaluation mode."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, value in network.state_dict().items():
            if value.ndim > 1:
                value.copy_(torch.randn(value.shape, generator=generator) * (1.5 / value[0].numel() ** 0.5))
            elif value.is_floating_point():
                value.copy_(
                    torch.rand(value.shape, generator=generator) * 0.5 + (0.0 if name.endswith("bias") else 0.5)
                )
    return network.eval()


def fold(network: nn.Module) -> nn.Module:
    fold_norms(network)
    return network
