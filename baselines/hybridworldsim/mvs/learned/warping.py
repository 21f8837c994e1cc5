"""Where pixels of a reference picture are in another picture, for given depths, and what is found there.

A feature of stride s is centred on pixel s i of its picture, counted from 0: the convolutions that halve a picture are
centred on every second pixel. Motions between cameras are composed in float64; only their product with the intrinsics,
whose size does not depend on where in the world the cameras are, becomes float32.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from hybridworldsim.mvs.estimator import PosedPicture
from mirror.arrays import Float64

_OUTSIDE = -4.0
_BEHIND = 1e-6


@dataclass(frozen=True, eq=False)
class Motion:
    """``source = rotation @ (u, v, 1) depth + translation``, in homogeneous samples of the source.

    Attributes:
        rotation: (3, 3) ``K_source R K_reference^-1``.
        translation: (3,) ``K_source t``, in samples times metres.
    """

    rotation: Float64
    translation: Float64


def relative_motion(reference: PosedPicture, source: PosedPicture, stride: int) -> Motion:
    """From samples of the reference, taken at a stride, to those of a source at the same stride."""
    source_SE3_reference = source.world_SE3_camera.inverse().compose(reference.world_SE3_camera).matrix()[0]
    to_source = _sample_intrinsics(source.K, stride)
    from_reference = np.linalg.inv(_sample_intrinsics(reference.K, stride))
    return Motion(to_source @ source_SE3_reference[:3, :3] @ from_reference, to_source @ source_SE3_reference[:3, 3])


def baseline_m(reference: PosedPicture, source: PosedPicture) -> float:
    """Distance between the centres of two cameras."""
    return float(np.linalg.norm(source.world_SE3_camera.translation - reference.world_SE3_camera.translation))


def source_positions(motion: Motion, depth_m: Tensor, width: int, height: int) -> Tensor:
    """Where samples of the reference are in a source.

    Args:
        motion: of the source.
        depth_m: (D, H, W) hypotheses of every sample of the reference.
        width: of the source, in samples.
        height: of the source, in samples.

    Returns:
        (D, H, W, 2) in the form that ``grid_sample`` takes with corners not aligned: from -1 to 1 is from the outer
        edge of the first sample to that of the last. Points behind the source are far outside.
    """
    depths, rows, columns = depth_m.shape
    rotation = torch.from_numpy(motion.rotation).float()
    horizontal, vertical, forward = torch.from_numpy(motion.translation).float().tolist()
    v, u = torch.meshgrid(torch.arange(rows).float(), torch.arange(columns).float(), indexing="ij")
    ray = torch.einsum("ij,jhw->ihw", rotation, torch.stack((u, v, torch.ones_like(u))))
    z = ray[2] * depth_m + forward
    seen = z > _BEHIND * depth_m
    scale = torch.where(seen, z, 1.0).reciprocal_()
    positions = torch.empty((depths, rows, columns, 2))
    for axis, (start, size) in enumerate(((horizontal, width), (vertical, height))):
        at = (ray[axis] * depth_m).add_(start).mul_(scale).add_(0.5).mul_(2.0 / size).sub_(1.0)
        positions[..., axis] = torch.where(seen, at, _OUTSIDE).clamp_(_OUTSIDE, -_OUTSIDE)
    return positions


def sample(feature: Tensor, positions: Tensor) -> Tensor:
    """Features at positions, bilinear, zero outside.

    Args:
        feature: (C, h, w) of a source.
        positions: (D, H, W, 2) of `source_positions`.

    Returns:
        (C, D, H, W).
    """
    depths, rows, columns, _ = positions.shape
    found = functional.grid_sample(
        feature[None], positions.view(1, depths * rows, columns, 2), "bilinear", "zeros", align_corners=False
    )
    return found.view(-1, depths, rows, columns)


def _sample_intrinsics(K: Float64, stride: int) -> Float64:
    """Intrinsics in samples whose first has its centre, at 0, on the first pixel's, whose place in K is 0.5."""
    centred = K - np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
    return centred / np.array([[stride], [stride], [1.0]])
