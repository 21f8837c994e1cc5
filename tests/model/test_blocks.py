from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hybridworldsim.model.blocks import Block, divide, select_views
from mirror.errors import UsageError
from mirror.protocols.views.view import RenderView
from tests.draws import draws
from tests.model.streets import view

UTM = np.array([441_000.0, 4_475_000.0, 600.0])


def line(length_m: float, step_m: float = 1.0) -> np.ndarray:
    x = np.arange(0.0, length_m + step_m, step_m)
    return np.column_stack((x, 0.1 * x, 0.01 * x))


def test_a_short_street_is_one_centred_block() -> None:
    (block,) = divide(line(90.0)).blocks
    np.testing.assert_allclose(block.origin_m, (45.0, 4.5, 0.45), atol=0.02)


def test_blocks_overlap_by_a_quarter() -> None:
    division = divide(line(250.0))
    xs = [block.origin_m[0] for block in division.blocks]
    assert len(xs) == 3
    np.testing.assert_allclose(np.diff(xs), 75.0)
    assert all(block.overlap_m == 25.0 for block in division.blocks)


def test_blocks_where_nobody_drove_are_skipped_and_counted() -> None:
    corner = np.concatenate((line(250.0), line(250.0)[:, [1, 0, 2]]))
    division = divide(corner)
    assert len(division.blocks) + division.skipped == 9
    assert division.skipped == 4


@settings(max_examples=draws(40), deadline=None)
@given(st.integers(0, 2**31), st.floats(1.0, 400.0), st.floats(10.0, 150.0))
def test_blocks_cover_all_driven_places_in_any_order(seed: int, length: float, size: float) -> None:
    rng = np.random.default_rng(seed)
    driven = np.column_stack((rng.uniform(0.0, length, (50, 2)), np.zeros(50)))
    division = divide(driven, size)
    assert division == divide(rng.permutation(driven), size)
    covered = np.stack([block.distance_m(driven) for block in division.blocks]).min(axis=0)
    assert covered.max() <= 1e-9 * size
    moved = divide(driven + UTM, size)
    assert [block.index for block in moved.blocks] == [block.index for block in division.blocks]


def test_local_coordinates_keep_millimetres_at_utm_size() -> None:
    (block,) = divide(line(50.0) + UTM).blocks
    local = block.local(UTM + np.array([[0.001, 0.0, 0.0], [0.0, 0.0, 0.0]])).astype(np.float32)
    assert local[0, 0] - local[1, 0] == pytest.approx(0.001, abs=5e-6)


def test_points_beyond_the_overlap_are_far() -> None:
    block = Block((0, 0), (1000.0, 0.0, 0.0))
    points = np.array([[1074.0, 0.0, 0.0], [1076.0, 0.0, 0.0], [1000.0, -80.0, 300.0], [1000.0, 0.0, 300.0]])
    assert block.far(points).tolist() == [False, True, True, False]


def test_selected_views_are_in_the_block_or_near_and_see_it() -> None:
    block = Block((0, 0), (0.0, 0.0, 0.0))
    views = [view(0.0), view(-60.0), view(60.0), view(-80.0), view(-60.0, 45.0), view(-60.0, 90.0)]
    assert select_views(block, views) == (views[0], views[1], views[4])
    assert select_views(block, []) == ()


def turned(yaw_deg: float, pitch_deg: float, roll_deg: float, x_m: float, y_m: float) -> RenderView:
    """A level camera that looks along x, rolled about its axis, then tilted down, then turned to the left."""
    level = Rotation.from_matrix([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    about = Rotation.from_euler("ZYX", (yaw_deg, pitch_deg, roll_deg), degrees=True) * level
    return view(x_m, y_m).model_copy(update={"world_SE3_camera": (*about.as_quat(scalar_first=True), x_m, y_m, 1.5)})


@given(
    st.floats(-180, 180), st.floats(-90, 90), st.sampled_from([0.0, 90.0, -90.0, 180.0]),
    st.floats(-90, 90), st.floats(-90, 90),
)  # fmt: skip
@settings(max_examples=draws(200), deadline=None)
def test_rotated_cameras_are_selected_if_they_see_the_block(
    yaw_deg: float, pitch_deg: float, roll_deg: float, x_m: float, y_m: float
) -> None:
    """A view that shows a near place of the block is selected for the block."""
    block = Block((0, 0), (0.0, 0.0, 0.0), 100.0, 25.0)
    one = turned(yaw_deg, pitch_deg, roll_deg, x_m, y_m)
    grid = np.linspace(-49.0, 49.0, 15)
    places = np.stack(np.meshgrid(grid, grid, [-1.0, 0.0, 3.0, 9.0]), axis=-1).reshape(-1, 3)
    near = np.linalg.norm(places[:, :2] - (x_m, y_m), axis=1) < 0.7 * 50.0
    if (one.lens.project(one.pose.inverse().transform(places)).valid & near).any():
        assert select_views(block, [one], 50.0) == (one,)


@pytest.mark.parametrize("driven", [np.empty((0, 3)), np.full((3, 3), np.nan), np.zeros((3, 2))])
def test_invalid_places_are_refused(driven: np.ndarray) -> None:
    with pytest.raises(UsageError, match="driven places"):
        divide(driven)
