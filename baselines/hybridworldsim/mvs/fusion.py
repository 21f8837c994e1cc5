"""Fusion: depths that other pictures confirm, and the thinned points that they make.

A depth is confirmed by another picture if the point that it makes, looked up in that picture's depth map and brought
back, lands within a pixel of where it came from and has nearly its depth (the check of MVSNet, Yao et al.,
ECCV 2018, section 4.2, and of Galliani et al., "Massively parallel multiview stereopsis", ICCV 2015).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numba
import numpy as np

from mirror.arrays import AnyArray, Bool, Float32, Float64, Int32, Int64, UInt8
from mirror.geometry.poses import Poses


@dataclass(frozen=True, eq=False)
class PosedDepth:
    """A depth map and where it was taken.

    Attributes:
        depth_m: (H, W) camera z; NaN where unknown.
        K: (3, 3) intrinsics.
        world_SE3_camera: one pose.
    """

    depth_m: Float32
    K: Float64
    world_SE3_camera: Poses


@dataclass(frozen=True, eq=False)
class ConfirmedDepth:
    """What other pictures say of a depth map.

    Attributes:
        views: (H, W) pictures that agree, the map's own included; 0 where the depth is unknown.
        depth_m: (H, W) the mean of the depths of all that agree, seen from here; NaN where unknown.
        spread_m: (H, W) their standard deviation; NaN where only one agrees.
    """

    views: Int32
    depth_m: Float32
    spread_m: Float32


def confirm(
    reference: PosedDepth, others: Sequence[PosedDepth], *, most_px: float = 1.0, most_share: float = 0.01
) -> ConfirmedDepth:
    """Hold a depth map against others.

    Args:
        reference: the map.
        others: those that may see the same.
        most_px: farthest that a point may come back from where it left.
        most_share: largest difference of depths, of the depth.
    """
    views = np.isfinite(reference.depth_m).astype(np.int32)
    total = np.where(views > 0, reference.depth_m, 0.0).astype(np.float64)
    square = total * total
    for other in others:
        forth = (other.world_SE3_camera.inverse() @ reference.world_SE3_camera).matrix()[0]
        back = np.linalg.inv(forth)
        _hold(
            reference.depth_m,
            other.depth_m,
            other.K @ forth[:3, :3] @ np.linalg.inv(reference.K),
            other.K @ forth[:3, 3],
            reference.K @ back[:3, :3] @ np.linalg.inv(other.K),
            reference.K @ back[:3, 3],
            most_px,
            most_share,
            views,
            total,
            square,
        )
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / views
        spread = np.sqrt(np.maximum(square / views - mean * mean, 0.0))
    depth = np.where(views > 0, mean, np.nan).astype(np.float32)
    return ConfirmedDepth(views, depth, np.where(views > 1, spread, np.nan).astype(np.float32))


@numba.njit(cache=True, parallel=True, nogil=True)
def _hold(
    reference: AnyArray,
    other: AnyArray,
    forth: AnyArray,
    forth_t: AnyArray,
    back: AnyArray,
    back_t: AnyArray,
    most_px: float,
    most_share: float,
    views: AnyArray,
    total: AnyArray,
    square: AnyArray,
) -> None:
    height, width = reference.shape
    for row in numba.prange(height):
        for column in range(width):
            z = np.float64(reference[row, column])
            if not z > 0.0:
                continue
            u, v = column + 0.5, row + 0.5
            q = forth[2, 0] * u + forth[2, 1] * v + forth[2, 2]
            far = z * q + forth_t[2]
            if far <= 0.0:
                continue
            x = (z * (forth[0, 0] * u + forth[0, 1] * v + forth[0, 2]) + forth_t[0]) / far
            y = (z * (forth[1, 0] * u + forth[1, 1] * v + forth[1, 2]) + forth_t[1]) / far
            if not (0.0 <= x < other.shape[1] and 0.0 <= y < other.shape[0]):
                continue
            i, j = int(y), int(x)
            there = np.float64(other[i, j])
            if not there > 0.0:
                continue
            # The other map's depth is that of its pixel; the point is brought back from where it landed in it.
            near = there * (back[2, 0] * x + back[2, 1] * y + back[2, 2]) + back_t[2]
            if near <= 0.0 or abs(near - z) > most_share * z:
                continue
            du = (there * (back[0, 0] * x + back[0, 1] * y + back[0, 2]) + back_t[0]) / near - u
            dv = (there * (back[1, 0] * x + back[1, 1] * y + back[1, 2]) + back_t[1]) / near - v
            if du * du + dv * dv <= most_px * most_px:
                views[row, column] += 1
                total[row, column] += near
                square[row, column] += near * near


@dataclass(frozen=True, eq=False)
class PointCloud:
    """N points.

    Attributes:
        position_m: (N, 3) in the world.
        rgb: (N, 3).
        views: (N,) pictures that agree.
        sigma_m: (N,) deviation along the ray; NaN: unknown.
    """

    position_m: Float64
    rgb: UInt8
    views: Int32
    sigma_m: Float32

    def __len__(self) -> int:
        return len(self.position_m)

    def only(self, chosen: Bool | Int64) -> PointCloud:
        """Some of the points."""
        return PointCloud(self.position_m[chosen], self.rgb[chosen], self.views[chosen], self.sigma_m[chosen])

    @classmethod
    def concatenate(cls, clouds: Sequence[PointCloud]) -> PointCloud:
        """Clouds one behind the other."""
        empty = cls(np.empty((0, 3)), np.empty((0, 3), np.uint8), np.empty(0, np.int32), np.empty(0, np.float32))
        every = [empty, *clouds]
        return cls(*(np.concatenate([getattr(one, name) for one in every]) for name in _FIELDS))


_FIELDS: Final = ("position_m", "rgb", "views", "sigma_m")


def make_point_cloud(
    confirmed: ConfirmedDepth, rgb: UInt8, K: Float64, world_SE3_camera: Poses, least_views: int
) -> PointCloud:
    """The points of a picture that at least so many pictures agree on."""
    row, column = np.nonzero(confirmed.views >= least_views)
    depth = confirmed.depth_m[row, column].astype(np.float64)
    pixels = np.column_stack([column + 0.5, row + 0.5, np.ones(len(row))])
    camera = (pixels @ np.linalg.inv(K).T) * depth[:, None]
    position = world_SE3_camera.transform(camera) if len(camera) else np.empty((0, 3))
    views = confirmed.views[row, column]
    # Where all agree exactly the depths were still rounded.
    sigma = np.maximum(confirmed.spread_m[row, column] / np.sqrt(views), 1e-4 * depth).astype(np.float32)
    return PointCloud(position.reshape(-1, 3), rgb[row, column], views, sigma)


class VoxelThinner:
    """Thins points: of each cell of a grid only the first cloud's best point is kept, found by sorted hashes.

    Memory: 8 bytes a cell that holds a point.

    Args:
        side_m: of a cell.
    """

    def __init__(self, side_m: float) -> None:
        self._side = side_m
        self._taken: Int64 = np.empty(0, np.int64)

    def thin(self, cloud: PointCloud) -> PointCloud:
        """The points in cells where there was none, one each: the one with most views; their cells are taken."""
        if not len(cloud):
            return cloud
        key = _cells(cloud.position_m, self._side)
        order = np.lexsort((np.arange(len(key)), -cloud.views, key))
        first = np.ones(len(key), np.bool_)
        first[1:] = key[order][1:] != key[order][:-1]
        chosen = order[first]
        # Both are sorted: to look up and to insert costs no sorting of all cells for each picture.
        place = np.searchsorted(self._taken, key[chosen])
        free = np.append(self._taken, -1)[place] != key[chosen]
        chosen = chosen[free]
        self._taken = np.insert(self._taken, place[free], key[chosen])
        return cloud.only(np.sort(chosen))


def _cells(position: Float64, side: float) -> Int64:
    """An integer for each cell of a grid: 21 bits a coordinate, so that cells 10 cm wide do not repeat for 200 km."""
    cell = np.floor(position / side).astype(np.int64) & ((1 << 21) - 1)
    return np.asarray(cell[:, 0] << 42 | cell[:, 1] << 21 | cell[:, 2])
