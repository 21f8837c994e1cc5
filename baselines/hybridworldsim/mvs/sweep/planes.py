"""Families of parallel planes to sweep over, as homographies between images and as inverse depths of pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybridworldsim.mvs.estimator import StereoImage
from mirror.arrays import Float64
from mirror.geometry.poses import Poses

_ROAD_M = (0.6, 4.0)
_STREET_M = (2.0, 40.0)
_MIN_MOTION_M = 0.05


@dataclass(frozen=True, eq=False)
class Planes:
    """P planes ``normal . X = offset_m`` in a camera's frame.

    Attributes:
        normal: (P, 3) unit vectors.
        offset_m: (P,) distances from the camera.
    """

    normal: Float64
    offset_m: Float64

    @classmethod
    def concatenate(cls, families: Sequence[Planes]) -> Planes:
        """Concatenate families of planes."""
        return cls(
            np.concatenate([family.normal for family in families]),
            np.concatenate([family.offset_m for family in families]),
        )

    def compute_homographies(self, reference: StereoImage, source: StereoImage) -> Float64:
        """Compute the homographies (P, 3, 3) of the planes from pixels of the reference to pixels of a source."""
        source_SE3_reference = source.world_SE3_camera.inverse() @ reference.world_SE3_camera
        matrix = source_SE3_reference.matrix()[0]
        # X_source = (R + t n^T / d) X for points X on the plane.
        motion = matrix[:3, :3] + matrix[:3, 3:] @ (self.normal / self.offset_m[:, None])[:, None, :]
        return np.asarray(source.K @ motion @ np.linalg.inv(reference.K))

    def compute_inverse_depth(self, K: Float64) -> Float64:
        """Compute coefficients (P, 3): their product with (u, v, 1) is the inverse depth of a plane at pixel (u, v)."""
        return np.asarray((self.normal / self.offset_m[:, None]) @ np.linalg.inv(K))


def make_facing_planes(count: int, near_m: float, far_m: float) -> Planes:
    """Make planes that face the camera, evenly spaced in inverse depth, the nearest first."""
    return _make_family(np.array([0.0, 0.0, 1.0]), _space_inverse(count, near_m, far_m))


def make_road_planes(count: int, world_SE3_camera: Poses) -> Planes:
    """Make level planes below the camera, evenly spaced in inverse distance over the heights of car and bus cameras."""
    down = _to_camera(world_SE3_camera, np.array([0.0, 0.0, -1.0]))
    return _make_family(down, _space_inverse(count, *_ROAD_M))


def make_upright_planes(count: int, world_SE3_camera: Poses, sources: Sequence[Poses], near_m: float) -> list[Planes]:
    """Make upright planes parallel to the motion from the image to its sources, on both sides; none without motion."""
    motion = np.zeros(2)
    for pose in sources:
        step = (pose.translation - world_SE3_camera.translation)[0, :2]
        # Neighbours ahead and behind lie on one line, in opposite directions.
        motion += step if step @ motion >= 0.0 else -step
    length = float(np.hypot(*motion))
    if length < _MIN_MOTION_M:
        return []
    left = _to_camera(world_SE3_camera, np.array([-motion[1], motion[0], 0.0]) / length)
    offsets = _space_inverse(count, max(near_m, _STREET_M[0]), max(2.0 * near_m, _STREET_M[1]))
    return [_make_family(left, offsets), _make_family(-left, offsets)]


def _make_family(normal: Float64, offset_m: Float64) -> Planes:
    """Make parallel planes of one normal (3,) at distances (P,)."""
    return Planes(np.tile(normal, (len(offset_m), 1)), offset_m)


def _space_inverse(count: int, near_m: float, far_m: float) -> Float64:
    """Space distances (count,) evenly in inverse distance, the nearest first."""
    return np.asarray(1.0 / np.linspace(1.0 / near_m, 1.0 / far_m, count))


def _to_camera(world_SE3_camera: Poses, direction: Float64) -> Float64:
    """Rotate a direction (3,) from the world to the camera frame."""
    return np.asarray(world_SE3_camera.matrix()[0, :3, :3].T @ direction)
