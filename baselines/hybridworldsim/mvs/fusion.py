"""Fusion: keeps depths that other images confirm, and makes thinned points of them.

Another image confirms a depth by reprojection: the point is projected into the other depth map, and the depth found
there is projected back. It must land within a pixel of the start and have nearly the same depth (the check of MVSNet,
Yao et al., ECCV 2018, section 4.2, and of Galliani et al., "Massively parallel multiview stereopsis", ICCV 2015).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numba
import numpy as np

from hybridworldsim.kernels.dispatch import runs_kernels
from hybridworldsim.kernels.threads import in_row_spans
from mirror.arrays import AnyArray, Bool, Float32, Float64, Int32, Int64, UInt8
from mirror.devices import CPU
from mirror.geometry.poses import Poses


@dataclass(frozen=True, eq=False)
class PosedDepth:
    """A depth map with its camera.

    Attributes:
        depth_m: (H, W) along the camera's z axis; NaN where unknown.
        K: (3, 3) intrinsics, px.
        world_SE3_camera: one pose.
    """

    depth_m: Float32
    K: Float64
    world_SE3_camera: Poses


@dataclass(frozen=True, eq=False)
class ConfirmedDepth:
    """A depth map compared with other depth maps.

    Attributes:
        views: (H, W) number of images that agree, the reference included; 0 where the depth is unknown.
        depth_m: (H, W) mean of the depths that agree, in the reference camera; NaN where unknown.
        spread_m: (H, W) their standard deviation; NaN where the reference is alone.
    """

    views: Int32
    depth_m: Float32
    spread_m: Float32


@dataclass(frozen=True, eq=False)
class _Motion:
    """The motions of pixels between two depth maps, ``z A (u, v, 1) + b``: (3, 3) A and (3,) b, forth and back."""

    forth: Float64
    forth_t: Float64
    back: Float64
    back_t: Float64


def confirm(
    reference: PosedDepth,
    others: Sequence[PosedDepth],
    *,
    max_px: float = 1.0,
    max_share: float = 0.01,
    device: str = CPU,
) -> ConfirmedDepth:
    """Compare a depth map with other depth maps.

    Args:
        reference: the depth map.
        others: depth maps that may show the same surfaces.
        max_px: greatest distance of a reprojected point from its start, px.
        max_share: greatest difference of depths, as a share of the depth.
        device: where they are compared, as torch names it: on the CPU by a compiled kernel, elsewhere in plain torch.
    """
    motions = [_relate(reference, other) for other in others]
    add_all = _add_compiled if runs_kernels(device) else partial(_add_elsewhere, device)
    views = np.isfinite(reference.depth_m).astype(np.int32)
    total = np.where(views > 0, reference.depth_m, 0.0).astype(np.float64)
    square = total * total
    add_all(reference, others, motions, max_px, max_share, views, total, square)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / views
        spread = np.sqrt(np.maximum(square / views - mean * mean, 0.0))
    depth = np.where(views > 0, mean, np.nan).astype(np.float32)
    return ConfirmedDepth(views, depth, np.where(views > 1, spread, np.nan).astype(np.float32))


def _relate(reference: PosedDepth, other: PosedDepth) -> _Motion:
    """Compute the motions between two depth maps."""
    forth = (other.world_SE3_camera.inverse() @ reference.world_SE3_camera).matrix()[0]
    back = np.linalg.inv(forth)
    return _Motion(
        other.K @ forth[:3, :3] @ np.linalg.inv(reference.K),
        other.K @ forth[:3, 3],
        reference.K @ back[:3, :3] @ np.linalg.inv(other.K),
        reference.K @ back[:3, 3],
    )


def _add_compiled(
    reference: PosedDepth,
    others: Sequence[PosedDepth],
    motions: Sequence[_Motion],
    max_px: float,
    max_share: float,
    views: Int32,
    total: Float64,
    square: Float64,
) -> None:
    """Add the depths of all other maps that agree to counts, sums and squared sums (H, W), by the kernel."""
    for other, motion in zip(others, motions, strict=True):
        matrices = motion.forth, motion.forth_t, motion.back, motion.back_t
        compared = reference.depth_m, other.depth_m, *matrices, max_px, max_share, views, total, square
        in_row_spans(partial(_count_agreeing, *compared), len(views))


def _add_elsewhere(
    device: str,
    reference: PosedDepth,
    others: Sequence[PosedDepth],
    motions: Sequence[_Motion],
    max_px: float,
    max_share: float,
    views: Int32,
    total: Float64,
    square: Float64,
) -> None:
    """Do as `_add_compiled`, in plain torch on a device, from which the sums are read once."""
    import torch

    from hybridworldsim.mvs.plain.fusion import OtherDepth, find_agreeing

    def move(array: Float32 | Float64) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(device)

    first = move(reference.depth_m)
    sums = torch.zeros(3, *first.shape, dtype=torch.float64, device=device)
    for other, motion in zip(others, motions, strict=True):
        matrices = (move(one) for one in (motion.forth, motion.forth_t, motion.back, motion.back_t))
        agreeing = find_agreeing(first, OtherDepth(move(other.depth_m), *matrices), max_px, max_share)
        sums += torch.stack((agreeing > 0.0, agreeing, agreeing * agreeing))
    added = sums.cpu().numpy()
    views += added[0].astype(np.int32)
    total += added[1]
    square += added[2]


@numba.njit(cache=True, nogil=True)
def _count_agreeing(
    reference: AnyArray,
    other: AnyArray,
    forth: AnyArray,
    forth_t: AnyArray,
    back: AnyArray,
    back_t: AnyArray,
    max_px: float,
    max_share: float,
    views: AnyArray,
    total: AnyArray,
    square: AnyArray,
    begin: int,
    end: int,
) -> None:
    """Add to the counts, sums and squared sums (H, W) of the reference the depths of another map that agree."""
    for row in range(begin, end):
        for column in range(reference.shape[1]):
            z = np.float64(reference[row, column])
            if not z > 0.0:
                continue
            u, v = column + 0.5, row + 0.5
            q = forth[2, 0] * u + forth[2, 1] * v + forth[2, 2]
            forth_z = z * q + forth_t[2]
            if forth_z <= 0.0:
                continue
            x = (z * (forth[0, 0] * u + forth[0, 1] * v + forth[0, 2]) + forth_t[0]) / forth_z
            y = (z * (forth[1, 0] * u + forth[1, 1] * v + forth[1, 2]) + forth_t[1]) / forth_z
            if not (0.0 <= x < other.shape[1] and 0.0 <= y < other.shape[0]):
                continue
            i, j = int(y), int(x)
            other_z = np.float64(other[i, j])
            if not other_z > 0.0:
                continue
            # The reprojection starts at the projected position with the depth of the pixel that contains it.
            back_z = other_z * (back[2, 0] * x + back[2, 1] * y + back[2, 2]) + back_t[2]
            if back_z <= 0.0 or abs(back_z - z) > max_share * z:
                continue
            du = (other_z * (back[0, 0] * x + back[0, 1] * y + back[0, 2]) + back_t[0]) / back_z - u
            dv = (other_z * (back[1, 0] * x + back[1, 1] * y + back[1, 2]) + back_t[1]) / back_z - v
            if du * du + dv * dv <= max_px * max_px:
                views[row, column] += 1
                total[row, column] += back_z
                square[row, column] += back_z * back_z


@dataclass(frozen=True, eq=False)
class PointCloud:
    """N points of surfaces.

    Attributes:
        position_m: (N, 3) in the world.
        rgb: (N, 3).
        views: (N,) number of images that agree.
        sigma_m: (N,) standard deviation along the ray; NaN where unknown.
    """

    position_m: Float64
    rgb: UInt8
    views: Int32
    sigma_m: Float32

    def __len__(self) -> int:
        return len(self.position_m)

    def select(self, rows: Bool | Int64) -> PointCloud:
        """Select points by a mask or by indices."""
        return PointCloud(self.position_m[rows], self.rgb[rows], self.views[rows], self.sigma_m[rows])

    @classmethod
    def concatenate(cls, clouds: Sequence[PointCloud]) -> PointCloud:
        """Concatenate clouds."""
        empty = cls(np.empty((0, 3)), np.empty((0, 3), np.uint8), np.empty(0, np.int32), np.empty(0, np.float32))
        parts = [empty, *clouds]
        return cls(*(np.concatenate([getattr(cloud, name) for cloud in parts]) for name in _FIELDS))


_FIELDS: Final = ("position_m", "rgb", "views", "sigma_m")


def make_point_cloud(
    confirmed: ConfirmedDepth, rgb: UInt8, K: Float64, world_SE3_camera: Poses, min_views: int
) -> PointCloud:
    """Make points of the pixels of an image on which at least `min_views` images agree."""
    row, column = np.nonzero(confirmed.views >= min_views)
    depth = confirmed.depth_m[row, column].astype(np.float64)
    pixels = np.column_stack([column + 0.5, row + 0.5, np.ones(len(row))])
    camera = (pixels @ np.linalg.inv(K).T) * depth[:, None]
    position = world_SE3_camera.transform(camera) if len(camera) else np.empty((0, 3))
    views = confirmed.views[row, column]
    # The floor covers the rounding of depths that agree exactly.
    sigma = np.maximum(confirmed.spread_m[row, column] / np.sqrt(views), 1e-4 * depth).astype(np.float32)
    return PointCloud(position.reshape(-1, 3), rgb[row, column], views, sigma)


class VoxelThinner:
    """A thinner of points to one per cell of a grid: the best point of the first cloud that has points in the cell.

    Cells are found by their sorted hashes. Memory: 8 bytes per occupied cell.

    Args:
        side_m: side of a cell.
    """

    def __init__(self, side_m: float) -> None:
        self._side = side_m
        self._occupied: Int64 = np.empty(0, np.int64)

    def thin(self, cloud: PointCloud) -> PointCloud:
        """Return the point with most views of each unoccupied cell, and mark these cells as occupied."""
        if not len(cloud):
            return cloud
        key = _hash_cells(cloud.position_m, self._side)
        order = np.lexsort((np.arange(len(key)), -cloud.views, key))
        first = np.ones(len(key), np.bool_)
        first[1:] = key[order][1:] != key[order][:-1]
        best = order[first]
        # Both lists are sorted, so that an image costs no sorting of all cells.
        place = np.searchsorted(self._occupied, key[best])
        free = np.append(self._occupied, -1)[place] != key[best]
        best = best[free]
        self._occupied = np.insert(self._occupied, place[free], key[best])
        return cloud.select(np.sort(best))


def _hash_cells(position: Float64, side: float) -> Int64:
    """Number the grid cell of each position: 21 bits per coordinate, so cells of 10 cm repeat after 200 km only."""
    cell = np.floor(position / side).astype(np.int64) & ((1 << 21) - 1)
    return np.asarray(cell[:, 0] << 42 | cell[:, 1] << 21 | cell[:, 2])
