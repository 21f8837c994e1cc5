"""Rigid motions against matrix algebra and the matrix exponential."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm

from mirror.errors import UsageError
from mirror.geometry import Poses, angle_between_deg, quaternion_exp
from tests.draws import draws
from tests.geometry.poses import random_poses


def twist_matrix(twist: np.ndarray) -> np.ndarray:
    (x, y, z), velocity = twist[:3], twist[3:]
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    matrix[:3, 3] = velocity
    return matrix


def apply(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ np.swapaxes(matrix[:, :3, :3], 1, 2) + matrix[:, None, :3, 3]


def test_compose_inverse_transform_agree_with_matrices() -> None:
    a_SE3_b, b_SE3_c = random_poses(100), random_poses(100, 1)
    composed = a_SE3_b @ b_SE3_c
    assert np.abs(composed.matrix() - a_SE3_b.matrix() @ b_SE3_c.matrix()).max() < 2e-14
    assert np.abs((a_SE3_b @ a_SE3_b.inverse()).matrix() - np.eye(4)).max() < 6e-14
    for count in (1, 3, 4, 50):
        points = np.random.default_rng(2).normal(size=(100, count, 3))
        assert np.abs(a_SE3_b.transform(points) - apply(a_SE3_b.matrix(), points)).max() < 2e-14
        assert (a_SE3_b.transform(points[0]) == a_SE3_b.transform(np.tile(points[:1], (100, 1, 1)))).all()


def test_one_pose_goes_with_many() -> None:
    one, many = random_poses(1), random_poses(5, 1)
    assert np.abs((one @ many).matrix() - one.matrix() @ many.matrix()).max() < 1e-14
    assert np.abs((many @ one).matrix() - many.matrix() @ one.matrix()).max() < 1e-14
    assert one.transform(np.zeros((4, 7, 3))).shape == (4, 7, 3)
    with pytest.raises(UsageError, match="5 poses with 3"):
        many.compose(random_poses(3))


def test_a_chain_of_many_stays_rigid() -> None:
    step = random_poses(1)
    way = Poses.identity()
    for _ in range(2000):
        way = way @ step
    assert abs(np.linalg.norm(way.rotation) - 1.0) < 1e-15


def test_log_and_exp_agree_with_the_matrix_exponential() -> None:
    generator = np.random.default_rng(0)
    for angle in (0.0, 1e-200, 1e-9, 1e-5, 0.00999, 0.01001, 0.5, 2.0, np.pi - 1e-6, np.pi - 1e-12):
        axis = generator.normal(size=(20, 3))
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        twist = np.concatenate((axis * angle, generator.normal(size=(20, 3))), axis=1)
        moved = Poses.exp(twist)
        assert np.abs(moved.matrix() - [expm(twist_matrix(row)) for row in twist]).max() < 5e-14
        assert np.abs(moved.log() - twist).max() < (1e-14 if angle < 3 else 1e-8)
        assert np.abs(Poses.exp(moved.log()).matrix() - moved.matrix()).max() < 2e-15 * 10


def test_exp_beyond_a_half_turn_and_log_at_one() -> None:
    twist = np.array([[0.0, 0, 5.0, 1, 2, 3], [7.0, 0, 0, 1, 2, 3]])
    assert np.abs(Poses.exp(twist).matrix() - [expm(twist_matrix(row)) for row in twist]).max() < 2e-14
    half_turn = Poses([[0.0, 1, 0, 0], [0.0, 0, 0.6, 0.8]], [[1.0, 2, 3], [4, 5, 6]])
    assert np.abs(Poses.exp(half_turn.log()).matrix() - half_turn.matrix()).max() < 5e-15


@given(arrays(np.float64, 6, elements=st.floats(-1.7, 1.7)))
@settings(max_examples=draws(100))
def test_log_inverts_exp(twist: np.ndarray) -> None:
    assert np.abs(Poses.exp(twist).log()[0] - twist).max() < 1e-13


def test_matrix_and_column_round_trips() -> None:
    poses = random_poses(50)
    back = Poses.from_matrix(poses.matrix())
    assert angle_between_deg(back.rotation, poses.rotation).max() < 1e-13
    assert (back.translation == poses.translation).all()
    for columns in (poses.to_columns(), pa.table(poses.to_columns())):
        back = Poses.from_columns(columns)
        assert (back.rotation == poses.rotation).all()
        assert (back.translation == poses.translation).all()
    with pytest.raises(UsageError, match="qw"):
        Poses.from_columns({"tx_m": [0.0]})
    with pytest.raises(UsageError, match=r"row 0.*transpose"):
        Poses.from_matrix(poses.matrix().swapaxes(1, 2))


def test_indexing() -> None:
    poses = random_poses(10)
    assert len(poses[3]) == 1
    assert (poses[-1].translation == poses.translation[-1:]).all()
    assert len(poses[2:5]) == 3
    assert len(poses[np.array([True] * 4 + [False] * 6)]) == 4
    assert [len(pose) for pose in poses] == [1] * 10
    with pytest.raises(IndexError):
        poses[10]


def test_huge_offsets_keep_their_digits() -> None:
    offset = np.array([4.2e6, -1.3e6, 5.1e6])
    poses = Poses(random_poses(100).rotation, offset + random_poses(100).translation)
    points = np.random.default_rng(1).normal(size=(100, 1, 3))
    there = poses.transform(points)
    assert np.abs(poses.inverse().transform(there) - points).max() < 1e-8
    assert np.abs(there - (offset + (there - offset))).max() <= np.spacing(5.1e6)


def test_empty_one_and_singular() -> None:
    empty = Poses(np.empty((0, 4)), np.empty((0, 3)))
    assert len(empty @ empty) == len(empty.inverse()) == len(empty @ Poses.identity()) == 0
    assert empty.transform(np.zeros((5, 3))).shape == (0, 5, 3)
    assert empty.matrix().shape == (0, 4, 4)
    assert empty.log().shape == (0, 6)
    assert Poses.identity(3).log().tolist() == np.zeros((3, 6)).tolist()
    assert Poses([2.0, 0, 0, 0], [1.0, 2, 3]).rotation.tolist() == [[1, 0, 0, 0]]
    for rotation, translation in (
        (np.zeros((1, 4)), np.zeros((1, 3))),
        (np.ones((1, 4)), np.full((1, 3), np.nan)),
        (np.ones((2, 4)), np.zeros((1, 3))),
        (np.ones((1, 3)), np.zeros((1, 3))),
    ):
        with pytest.raises(UsageError):
            Poses(rotation, translation)
    with pytest.raises(UsageError, match="row 1"):
        Poses.exp([[0.0] * 6, [np.inf] * 6])


def test_tiny_motions_do_not_vanish() -> None:
    twist = np.array([[1e-12, -2e-12, 3e-12, 1e-9, 2e-9, -3e-9]])
    moved = Poses.exp(twist)
    for _ in range(3):
        moved = moved @ Poses.exp(twist)
    assert np.allclose(moved.log(), 4 * twist, rtol=1e-12, atol=0)
    assert (quaternion_exp([1e-20, 0, 0])[1:] == [0.5e-20, 0, 0]).all()


def test_one_matrix_without_a_batch_axis() -> None:
    matrix = np.eye(4)
    matrix[:3, 3] = 1.0, 2.0, 3.0
    poses = Poses.from_matrix(matrix)
    assert len(poses) == 1
    np.testing.assert_array_equal(poses.translation, [[1.0, 2.0, 3.0]])
    for shape in ((4,), (1, 1, 4, 4)):
        with pytest.raises(UsageError, match="shape"):
            Poses.from_matrix(np.ones(shape))


def test_one_pose_has_one_matrix() -> None:
    assert Poses.identity(1).one_matrix().shape == (4, 4)
    for count in (0, 2):
        with pytest.raises(UsageError, match=f"{count} poses"):
            Poses.identity(count).one_matrix()
