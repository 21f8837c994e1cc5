"""Projects pixels of a reference image with given depths into a source image, and samples the source there.

Feature i of stride s is centred on pixel s i of its image, counted from 0: the convolutions that halve an image are
centred on every second pixel. Motions between cameras are composed in float64; only their product with the intrinsics
becomes float32, because its size does not depend on the position of the cameras in the world.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from hybridworldsim.mvs.estimator import StereoImage
from mirror.arrays import Float64

_OUTSIDE = -4.0
_MIN_DEPTH_RATIO = 1e-6


@dataclass(frozen=True, eq=False)
class SampleMotion:
    """A motion of samples: ``source = rotation @ (u, v, 1) depth + translation``, in homogeneous coordinates.

    Attributes:
        rotation: (3, 3) ``K_source R K_reference^-1``.
        translation: (3,) ``K_source t``, in samples times metres.
    """

    rotation: Float64
    translation: Float64


def compute_motion(reference: StereoImage, source: StereoImage, stride: int) -> SampleMotion:
    """Compute the motion from samples of the reference at a stride to samples of a source at the same stride."""
    source_SE3_reference = source.world_SE3_camera.inverse().compose(reference.world_SE3_camera).matrix()[0]
    to_source = _sample_intrinsics(source.K, stride)
    from_reference = np.linalg.inv(_sample_intrinsics(reference.K, stride))
    return SampleMotion(
        to_source @ source_SE3_reference[:3, :3] @ from_reference, to_source @ source_SE3_reference[:3, 3]
    )


def compute_baseline_m(reference: StereoImage, source: StereoImage) -> float:
    """Compute the distance between two camera centres."""
    return float(np.linalg.norm(source.world_SE3_camera.translation - reference.world_SE3_camera.translation))


def project_to_source(motion: SampleMotion, depth_m: Tensor, width: int, height: int) -> Tensor:
    """Project samples of the reference into a source.

    Args:
        motion: from the reference to the source.
        depth_m: (D, H, W) depth hypotheses of each sample of the reference.
        width: width of the source, in samples.
        height: height of the source, in samples.

    Returns:
        (D, H, W, 2) as ``grid_sample`` takes them with ``align_corners=False``: -1 is the outer edge of the first
        sample, 1 the outer edge of the last. Points behind the source get positions far outside.
    """
    depths, rows, columns = depth_m.shape
    rotation = torch.from_numpy(motion.rotation).float().to(depth_m.device)
    horizontal, vertical, forward = torch.from_numpy(motion.translation).float().tolist()
    v, u = sample_positions(rows, columns, depth_m.device)
    ray = torch.einsum("ij,jhw->ihw", rotation, torch.stack((u, v, torch.ones_like(u))))
    z = ray[2] * depth_m + forward
    in_front = z > _MIN_DEPTH_RATIO * depth_m
    scale = torch.where(in_front, z, 1.0).reciprocal_()
    positions = torch.empty((depths, rows, columns, 2), device=depth_m.device)
    for axis, (start, size) in enumerate(((horizontal, width), (vertical, height))):
        at = (ray[axis] * depth_m).add_(start).mul_(scale).add_(0.5).mul_(2.0 / size).sub_(1.0)
        positions[..., axis] = torch.where(in_front, at, _OUTSIDE).clamp_(_OUTSIDE, -_OUTSIDE)
    return positions


def sample_positions(rows: int, columns: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the row and the column (rows, columns) of each sample, float32."""
    v, u = torch.meshgrid(
        torch.arange(rows, device=device).float(), torch.arange(columns, device=device).float(), indexing="ij"
    )
    return v, u


def sample(feature: Tensor, positions: Tensor) -> Tensor:
    """Sample features at positions, bilinear, zero outside.

    Args:
        feature: (C, h, w) features of a source.
        positions: (D, H, W, 2) from `project_to_source`.

    Returns:
        (C, D, H, W).
    """
    depths, rows, columns, _ = positions.shape
    sampled = functional.grid_sample(
        feature[None], positions.view(1, depths * rows, columns, 2), "bilinear", "zeros", align_corners=False
    )
    return sampled.view(-1, depths, rows, columns)


def _sample_intrinsics(K: Float64, stride: int) -> Float64:
    """Convert intrinsics from pixels (first centre at 0.5) to samples of a stride (first centre at 0)."""
    centred = K - np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
    return centred / np.array([[stride], [stride], [1.0]])
