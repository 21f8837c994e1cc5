"""The uncertainty of each pass against the other passes: the same points, as it alone and as the others alone see them.

The rays of a pass and those of the others meet in two points for each point of the map. If the pass were elsewhere, its
points would be there too; the median of their distances about an image has the errors of its pose and little else.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.geometry import matrix_from_quaternion
from mirror.localisation.alignment.passes import SceneImages
from mirror.localisation.structure.maps import ImageMap

_LEAST: Final = 8
_LEAST_ANGLE_DEG: Final = 3.0
_FARTHEST_M: Final = 25.0


def pass_sigmas(scene: SceneImages, found: ImageMap, scale: float) -> dict[int, tuple[float, float]]:
    """Return 1-sigma of each pass' positions (m, all axes) and rotation (degrees, all axes) by its number.

    Args:
        scene: the images.
        found: their map.
        scale: metres per unit of the map.
    """
    owner = scene.number[found.used]
    ray, origin, point, row = _rays(scene, found)
    sigmas = {}
    for number in np.unique(owner).tolist():
        own = owner[row] == number
        mine, clear = _intersect(ray[own], origin[own], point[own], len(found.points))
        theirs, also = _intersect(ray[~own], origin[~own], point[~own], len(found.points))
        both = clear & also
        offsets = scale * (mine - theirs)
        by_image = []
        for image in np.flatnonzero(owner == number).tolist():
            seen = found.observed[image][0]
            seen = seen[both[seen]]
            near = scale * np.linalg.norm(found.points[seen] - found.world_SE3_camera.translation[image], axis=1)
            seen = seen[near < _FARTHEST_M]
            if len(seen) >= _LEAST:
                by_image.append(np.median(offsets[seen], axis=0))
        if len(by_image) >= 2:
            shifts = np.array(by_image)
            places = np.flatnonzero(both)
            turn = _turn_deg(found.points[places], offsets[places] / scale)
            sigmas[number] = (float(np.sqrt((shifts**2).sum(axis=1).mean())), turn)
    return sigmas


def _rays(scene: SceneImages, found: ImageMap) -> tuple[Float64, Float64, Int64, Int64]:
    """Return the rays (M, 3) of all observations, their origins (M, 3), points (M,) and rows of the map (M,)."""
    turns, ray, origin, point, row = matrix_from_quaternion(found.world_SE3_camera.rotation), [], [], [], []
    for place, (points, features) in enumerate(found.observed):
        image = int(found.used[place])
        lens = scene.calibrations[scene.camera[image]].model
        way = lens.unproject(scene.features[image].uv_px[features]).direction @ turns[place].T
        ray.append(way / np.linalg.norm(way, axis=1)[:, None])
        origin.append(np.repeat(found.world_SE3_camera.translation[place][None], len(points), axis=0))
        point.append(points)
        row.append(np.full(len(points), place, np.int64))
    return np.concatenate(ray), np.concatenate(origin), np.concatenate(point), np.concatenate(row)


def _intersect(ray: Float64, origin: Float64, point: Int64, count: int) -> tuple[Float64, Bool]:
    """Return the points (count, 3) nearest to their rays, and which of them the rays determine."""
    across = np.eye(3) - ray[:, :, None] * ray[:, None, :]
    matrix, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(matrix, point, across)
    np.add.at(right, point, np.einsum("mij,mj->mi", across, origin))
    # The least eigenvalue is the sum of the squared sines of the angles to the common direction.
    clear = np.linalg.eigvalsh(matrix)[:, 0] > 0.5 * np.sin(np.radians(_LEAST_ANGLE_DEG)) ** 2
    places = np.full((count, 3), np.nan)
    places[clear] = np.linalg.solve(matrix[clear], right[clear][..., None])[..., 0]
    return places, clear


def _turn_deg(places: Float64, offsets: Float64) -> float:
    """Return the angle of the rigid motion that moves points (N, 3) by small offsets (N, 3); wild ones count little."""
    x, y, z = (places - places.mean(axis=0)).T
    zero = np.zeros(len(x))
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    design = np.concatenate([np.broadcast_to(np.eye(3), skew.shape), -skew], axis=2)
    motion = np.zeros(6)
    for _ in range(10):
        off = np.linalg.norm(offsets - design @ motion, axis=1)
        weight = 1.0 / (1.0 + (off / max(float(np.median(off)), 1e-12)) ** 2)
        matrix = np.einsum("n,nki,nkj->ij", weight, design, design)
        motion = np.linalg.solve(matrix, np.einsum("n,nki,nk->i", weight, design, offsets))
    return float(np.degrees(np.linalg.norm(motion[3:])))
