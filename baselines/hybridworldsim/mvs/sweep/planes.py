"""Planes to sweep over: families of parallel ones, as homographies between pictures and as depths of pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybridworldsim.mvs.estimator import PosedPicture
from mirror.arrays import Float64
from mirror.geometry.poses import Poses

_ROAD_M = (0.6, 4.0)
_STREET_M = (2.0, 40.0)
_STILL_M = 0.05


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
    def together(cls, families: Sequence[Planes]) -> Planes:
        """Families one behind the other."""
        return cls(
            np.concatenate([one.normal for one in families]),
            np.concatenate([one.offset_m for one in families]),
        )

    def homographies(self, reference: PosedPicture, source: PosedPicture) -> Float64:
        """(P, 3, 3) from pixels of the reference to pixels of a source, by each plane."""
        source_SE3_reference = source.world_SE3_camera.inverse() @ reference.world_SE3_camera
        matrix = source_SE3_reference.matrix()[0]
        # X_source = (R + t n^T / d) X for points of the plane.
        moved = matrix[:3, :3] + matrix[:3, 3:] @ (self.normal / self.offset_m[:, None])[:, None, :]
        return np.asarray(source.K @ moved @ np.linalg.inv(reference.K))

    def inverse_depth(self, K: Float64) -> Float64:
        """(P, 3) so that the inverse depth of a plane at a pixel (u, v) is the product with (u, v, 1)."""
        return np.asarray((self.normal / self.offset_m[:, None]) @ np.linalg.inv(K))


def facing_planes(count: int, near_m: float, far_m: float) -> Planes:
    """Planes that face the camera, evenly spaced in inverse depth, the nearest first."""
    return _family(np.array([0.0, 0.0, 1.0]), _evenly_inverse(count, near_m, far_m))


def road_planes(count: int, world_SE3_camera: Poses) -> Planes:
    """Level planes below the camera, evenly spaced in inverse distance: a car's camera or a bus's."""
    down = _in_camera(world_SE3_camera, np.array([0.0, 0.0, -1.0]))
    return _family(down, _evenly_inverse(count, *_ROAD_M))


def upright_planes(count: int, world_SE3_camera: Poses, sources: Sequence[Poses], near_m: float) -> list[Planes]:
    """Upright planes along the way from the picture to its sources, on both sides; none if it is not on any way."""
    way = np.zeros(2)
    for pose in sources:
        step = (pose.translation - world_SE3_camera.translation)[0, :2]
        # Neighbours before and behind lie on one line.
        way += step if step @ way >= 0.0 else -step
    length = float(np.hypot(*way))
    if length < _STILL_M:
        return []
    aside = _in_camera(world_SE3_camera, np.array([-way[1], way[0], 0.0]) / length)
    offsets = _evenly_inverse(count, max(near_m, _STREET_M[0]), max(2.0 * near_m, _STREET_M[1]))
    return [_family(aside, offsets), _family(-aside, offsets)]


def _family(normal: Float64, offset_m: Float64) -> Planes:
    return Planes(np.tile(normal, (len(offset_m), 1)), offset_m)


def _evenly_inverse(count: int, near_m: float, far_m: float) -> Float64:
    return np.asarray(1.0 / np.linspace(1.0 / near_m, 1.0 / far_m, count))


def _in_camera(world_SE3_camera: Poses, direction: Float64) -> Float64:
    """A direction of the world in the camera's frame."""
    return np.asarray(world_SE3_camera.matrix()[0, :3, :3].T @ direction)
