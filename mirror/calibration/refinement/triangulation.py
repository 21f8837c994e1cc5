"""Points of tracks, from the rays of their features and the recorded poses."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.calibration.estimate import FARTHEST_M
from mirror.calibration.refinement.rigs import FeatureTracks, MovingRigs
from mirror.geometry import matrix_from_quaternion

_LEAST_ANGLE_DEG: Final = 0.7
_WORST_DEG: Final = 6.0


def triangulate(rigs: MovingRigs, tracks: FeatureTracks) -> tuple[Float64, Bool]:
    """Return the points with the least squared distances from the rays of their tracks.

    Args:
        rigs: the recorded rigs.
        tracks: the tracks.

    Returns:
        Points (T, 3), and which observations (M,) are usable: a track's rays meet at an angle, the point lies in front
        of its cameras, at most 200 m away, and within 6 degrees of each ray.
    """
    poses = rigs.world_SE3_cameras()
    turns = matrix_from_quaternion(poses.rotation)
    origin = poses.translation[tracks.image]
    ray = np.full((len(tracks.image), 3), np.nan)
    mounting = rigs.mounting[tracks.image]
    for number in np.unique(mounting):
        own = mounting == number
        ray[own] = rigs.cameras[number].unproject(tracks.uv_px[own]).direction
    way = np.einsum("mij,mj->mi", turns[tracks.image], ray)
    # Relative to the first camera of each track, so that far from the world's origin no digits are lost.
    first = origin[tracks.starts[:-1]] if len(tracks) else np.empty((0, 3))
    local = origin - first[tracks.track]
    across = np.eye(3) - way[:, :, None] * way[:, None, :]
    matrix, right = np.zeros((len(tracks), 3, 3)), np.zeros((len(tracks), 3))
    np.add.at(matrix, tracks.track, across)
    np.add.at(right, tracks.track, np.einsum("mij,mj->mi", across, local))
    # The least eigenvalue is the sum of squared sines of the angles to the common direction.
    finite = np.isfinite(matrix).all(axis=(1, 2))
    spread = np.zeros(len(tracks))
    spread[finite] = np.linalg.eigvalsh(matrix[finite])[:, 0]
    solvable = spread > 0.5 * np.sin(np.radians(_LEAST_ANGLE_DEG)) ** 2
    points = np.full((len(tracks), 3), np.nan)
    points[solvable] = np.linalg.solve(matrix[solvable], right[solvable][..., None])[..., 0]
    to_point = points[tracks.track] - local
    distance = np.linalg.norm(to_point, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.einsum("mi,mi->m", to_point, way) / distance
        usable = (cosine > np.cos(np.radians(_WORST_DEG))) & (distance < FARTHEST_M)
    return points + first, usable
