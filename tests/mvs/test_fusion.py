"""Tests fusion against depths in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from hybridworldsim.mvs.fusion import PointCloud, PosedDepth, VoxelThinner, confirm, make_point_cloud
from mirror.geometry.poses import Poses
from tests.mvs.images import SIZE, Wall, compute_depth, make_intrinsics

WALL = Wall()


def make_depth(x_m: float, wall: Wall = WALL, factor: float = 1.0) -> PosedDepth:
    pose = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[x_m, 0.0, 0.0]]))
    return PosedDepth((compute_depth(wall, x_m) * factor).astype(np.float32), make_intrinsics(), pose)


def test_true_depths_agree_and_wrong_depths_do_not() -> None:
    confirmed = confirm(make_depth(0.0), [make_depth(0.5), make_depth(-0.5)])
    # All three cameras see the middle, two see the sides.
    assert (confirmed.views[:, 20:-20] == 3).all() and confirmed.views.min() == 2
    assert (confirm(make_depth(0.0), [make_depth(0.5, factor=1.05)]).views == 1).all()
    assert (confirm(make_depth(0.0), [make_depth(0.5, factor=1.005)]).views[:, 20:-20] == 2).all()


def test_mean_and_spread_cover_all_depths_that_agree() -> None:
    confirmed = confirm(make_depth(0.0), [make_depth(0.0, factor=1.006)])
    np.testing.assert_allclose(confirmed.depth_m, compute_depth(Wall(), 0.0) * 1.003, rtol=1e-5)
    np.testing.assert_allclose(confirmed.spread_m, compute_depth(Wall(), 0.0) * 0.003, rtol=1e-2)


@pytest.mark.parametrize("value", [np.nan, 0.0])
def test_unknown_depths_agree_with_nothing(value: float) -> None:
    unknown = PosedDepth(np.full(SIZE[::-1], np.nan, np.float32), make_intrinsics(), Poses.identity())
    other = PosedDepth(np.full(SIZE[::-1], value, np.float32), make_intrinsics(), Poses.identity())
    assert not confirm(unknown, [make_depth(0.5)]).views.any()
    assert (confirm(make_depth(0.0), [other]).views == 1).all()
    assert len(confirm(unknown, []).views) == SIZE[1]


def test_surface_behind_the_other_camera_does_not_agree() -> None:
    back = Poses(np.array([[0.0, 0.0, 1.0, 0.0]]), np.zeros((1, 3)))
    behind = PosedDepth(make_depth(0.0).depth_m, make_intrinsics(), back)
    assert (confirm(make_depth(0.0), [behind]).views == 1).all()


def test_points_lie_on_the_surface() -> None:
    wall = Wall((0.3, 0.0, 0.95), 9.0)
    reference = make_depth(0.4, wall)
    confirmed = confirm(reference, [make_depth(0.0, wall), make_depth(0.8, wall)])
    rgb = np.random.default_rng(0).integers(0, 255, (*SIZE[::-1], 3)).astype(np.uint8)
    cloud = make_point_cloud(confirmed, rgb, reference.K, reference.world_SE3_camera, 2)
    off = cloud.position_m @ np.array(wall.normal) - wall.offset_m
    assert len(cloud) > 1000 and np.abs(off).max() < 0.05
    assert cloud.views.min() >= 2 and (cloud.sigma_m > 0.0).all()
    assert len(make_point_cloud(confirmed, rgb, reference.K, reference.world_SE3_camera, 9)) == 0


def make_cloud(position: np.ndarray, views: list[int]) -> PointCloud:
    count = len(position)
    return PointCloud(position, np.zeros((count, 3), np.uint8), np.array(views, np.int32), np.ones(count, np.float32))


def test_cell_keeps_the_point_with_most_views_once() -> None:
    voxels = VoxelThinner(1.0)
    thinned = voxels.thin(make_cloud(np.array([[0.1, 0.1, 0.1], [0.9, 0.9, 0.9], [-0.1, 0.1, 0.1]]), [2, 3, 2]))
    assert thinned.position_m.tolist() == [[0.9, 0.9, 0.9], [-0.1, 0.1, 0.1]]
    second = voxels.thin(make_cloud(np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5]]), [9, 9]))
    assert second.position_m.tolist() == [[1.5, 0.5, 0.5]]
    assert len(voxels.thin(make_cloud(np.empty((0, 3)), []))) == 0


def test_thinning_equals_a_dictionary_of_cells() -> None:
    rng = np.random.default_rng(3)
    position, views = rng.normal(0.0, 3.0, (4000, 3)) + np.array([1e5, -2e5, 10.0]), rng.integers(2, 6, 4000).tolist()
    voxels, thinned = VoxelThinner(0.5), []
    # A cell belongs to the first cloud with a point in it.
    for start in range(0, 4000, 800):
        part = slice(start, start + 800)
        thinned += voxels.thin(make_cloud(position[part], views[part])).position_m.tolist()
    best: dict[tuple[int, ...], int] = {}
    for row, (place, count) in enumerate(zip(position, views)):
        key = tuple(np.floor(place / 0.5).astype(int).tolist())
        if key not in best or (row // 800 == best[key] // 800 and count > views[best[key]]):
            best[key] = row
    np.testing.assert_array_equal(thinned, position[sorted(best.values())])
