"""Fusion against depths in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from hybridworldsim.mvs.fusion import PointCloud, PosedDepth, VoxelThinner, confirm, make_point_cloud
from mirror.geometry.poses import Poses
from tests.mvs.images import SIZE, Wall, depth_of, intrinsics

WALL = Wall()


def posed(x_m: float, wall: Wall = WALL, change: float = 1.0) -> PosedDepth:
    pose = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[x_m, 0.0, 0.0]]))
    return PosedDepth((depth_of(wall, x_m) * change).astype(np.float32), intrinsics(), pose)


def test_true_depths_agree_and_false_ones_do_not() -> None:
    found = confirm(posed(0.0), [posed(0.5), posed(-0.5)])
    # The middle is seen by all three, the sides by two.
    assert (found.views[:, 20:-20] == 3).all() and found.views.min() == 2
    assert (confirm(posed(0.0), [posed(0.5, change=1.05)]).views == 1).all()
    assert (confirm(posed(0.0), [posed(0.5, change=1.005)]).views[:, 20:-20] == 2).all()


def test_the_mean_and_the_spread_are_those_of_all_that_agree() -> None:
    found = confirm(posed(0.0), [posed(0.0, change=1.006)])
    np.testing.assert_allclose(found.depth_m, depth_of(Wall(), 0.0) * 1.003, rtol=1e-5)
    np.testing.assert_allclose(found.spread_m, depth_of(Wall(), 0.0) * 0.003, rtol=1e-2)


@pytest.mark.parametrize("value", [np.nan, 0.0])
def test_unknown_depths_agree_with_nothing(value: float) -> None:
    unknown = PosedDepth(np.full(SIZE[::-1], np.nan, np.float32), intrinsics(), Poses.identity())
    other = PosedDepth(np.full(SIZE[::-1], value, np.float32), intrinsics(), Poses.identity())
    assert not confirm(unknown, [posed(0.5)]).views.any()
    assert (confirm(posed(0.0), [other]).views == 1).all()
    assert len(confirm(unknown, []).views) == SIZE[1]


def test_what_is_behind_a_camera_does_not_agree() -> None:
    back = Poses(np.array([[0.0, 0.0, 1.0, 0.0]]), np.zeros((1, 3)))
    behind = PosedDepth(posed(0.0).depth_m, intrinsics(), back)
    assert (confirm(posed(0.0), [behind]).views == 1).all()


def test_points_lie_where_the_surface_is() -> None:
    wall = Wall((0.3, 0.0, 0.95), 9.0)
    reference = posed(0.4, wall)
    found = confirm(reference, [posed(0.0, wall), posed(0.8, wall)])
    rgb = np.random.default_rng(0).integers(0, 255, (*SIZE[::-1], 3)).astype(np.uint8)
    cloud = make_point_cloud(found, rgb, reference.K, reference.world_SE3_camera, 2)
    off = cloud.position_m @ np.array(wall.normal) - wall.offset_m
    assert len(cloud) > 1000 and np.abs(off).max() < 0.05
    assert cloud.views.min() >= 2 and (cloud.sigma_m > 0.0).all()
    assert len(make_point_cloud(found, rgb, reference.K, reference.world_SE3_camera, 9)) == 0


def made(position: np.ndarray, views: list[int]) -> PointCloud:
    count = len(position)
    return PointCloud(position, np.zeros((count, 3), np.uint8), np.array(views, np.int32), np.ones(count, np.float32))


def test_a_cell_keeps_the_point_with_most_views_and_is_then_taken() -> None:
    voxels = VoxelThinner(1.0)
    kept = voxels.thin(made(np.array([[0.1, 0.1, 0.1], [0.9, 0.9, 0.9], [-0.1, 0.1, 0.1]]), [2, 3, 2]))
    assert kept.position_m.tolist() == [[0.9, 0.9, 0.9], [-0.1, 0.1, 0.1]]
    again = voxels.thin(made(np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5]]), [9, 9]))
    assert again.position_m.tolist() == [[1.5, 0.5, 0.5]]
    assert len(voxels.thin(made(np.empty((0, 3)), []))) == 0


def test_thinning_is_that_of_a_plain_reference() -> None:
    rng = np.random.default_rng(3)
    position, views = rng.normal(0.0, 3.0, (4000, 3)) + np.array([1e5, -2e5, 10.0]), rng.integers(2, 6, 4000).tolist()
    voxels, kept = VoxelThinner(0.5), []
    # Cloud by cloud: a cell belongs to the first that has a point in it.
    for start in range(0, 4000, 800):
        own = slice(start, start + 800)
        kept += voxels.thin(made(position[own], views[own])).position_m.tolist()
    best: dict[tuple[int, ...], int] = {}
    for row, (place, count) in enumerate(zip(position, views)):
        key = tuple(np.floor(place / 0.5).astype(int).tolist())
        if key not in best or (row // 800 == best[key] // 800 and count > views[best[key]]):
            best[key] = row
    np.testing.assert_array_equal(kept, position[sorted(best.values())])
