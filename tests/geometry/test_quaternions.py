"""Quaternions against scipy and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation, Slerp

from mirror.errors import UsageError
from mirror.geometry import (
    angle_between_deg,
    heading_deg,
    matrix_from_quaternion,
    quaternion_exp,
    quaternion_from_heading_pitch_roll,
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_log,
    quaternion_multiply,
    quaternion_normalise,
    rotate,
    slerp,
)
from mirror.geometry.blocks import BLOCK_VALUES
from tests.draws import draws

EPS = np.finfo(np.float64).eps


def random_rotations(count: int, seed: int = 0) -> np.ndarray:
    return quaternion_normalise(np.random.default_rng(seed).normal(size=(count, 4)))


def scipy_rotation(quaternion: np.ndarray) -> Rotation:
    return Rotation.from_quat(quaternion, scalar_first=True)


def awkward_rotations() -> np.ndarray:
    """Half turns about every kind of axis, tiny turns, and turns a hair short of a half turn."""
    axes = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, -1], [0, -1, 1], [1, -2, 3], [-1e-9, 1, 0]])
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    angles = np.array([0.0, 1e-300, 1e-160, 1e-16, 1e-8, 1e-4, np.pi / 2, np.pi - 1e-4, np.pi - 1e-9, np.pi])
    half, axes = 0.5 * np.repeat(angles, len(axes))[:, None], np.tile(axes, (len(angles), 1))
    return quaternion_normalise(np.concatenate((np.cos(half), np.sin(half) * axes), axis=1))


def test_agrees_with_scipy() -> None:
    a, b = random_rotations(500), random_rotations(500, 1)
    points = np.random.default_rng(2).normal(size=(500, 3))
    ours, theirs = quaternion_multiply(a, b), (scipy_rotation(a) * scipy_rotation(b)).as_quat(True, scalar_first=True)
    assert np.abs(ours - theirs).max() < 8 * EPS
    assert np.abs(rotate(a, points) - scipy_rotation(a).apply(points)).max() < 16 * EPS
    assert np.abs(matrix_from_quaternion(a) - scipy_rotation(a).as_matrix()).max() < 8 * EPS
    assert np.abs(quaternion_log(a) - scipy_rotation(a).as_rotvec()).max() < 16 * EPS
    assert np.abs(quaternion_exp(quaternion_log(a)) - a).max() < 8 * EPS
    angle = np.degrees((scipy_rotation(a).inv() * scipy_rotation(b)).magnitude())
    assert np.abs(angle_between_deg(a, b) - angle).max() < 1e-13


def test_slerp_agrees_with_scipy() -> None:
    a, b = random_rotations(200), random_rotations(200, 1)
    share = np.random.default_rng(2).random(200)
    theirs = [
        Slerp([0, 1], scipy_rotation(np.stack((p, q))))(u).as_quat(True, scalar_first=True)
        for p, q, u in zip(a, b, share)
    ]
    assert np.abs(slerp(a, b, share) - theirs).max() < 16 * EPS


@pytest.mark.parametrize("quaternions", [random_rotations(300), awkward_rotations()], ids=["random", "awkward"])
def test_matrix_round_trip_is_exact_for_every_rotation(quaternions: np.ndarray) -> None:
    back = quaternion_from_matrix(matrix_from_quaternion(quaternions))
    assert angle_between_deg(back, quaternions).max() < 1e-13
    assert (back[:, 0] >= 0).all()


@pytest.mark.parametrize("quaternions", [random_rotations(300), awkward_rotations()], ids=["random", "awkward"])
def test_log_exp_round_trip(quaternions: np.ndarray) -> None:
    vector = quaternion_log(quaternions)
    assert (np.linalg.norm(vector, axis=1) <= np.pi * (1 + EPS)).all()
    assert angle_between_deg(quaternion_exp(vector), quaternions).max() < 1e-13


@given(arrays(np.float64, 3, elements=st.floats(-1e-3, 1e-3)))
def test_tiny_rotation_vectors_keep_their_digits(vector: np.ndarray) -> None:
    back = quaternion_log(quaternion_exp(vector))
    assert np.allclose(back, vector, rtol=4 * EPS, atol=1e-300)


@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.floats(1e-12, 1e-3))
@settings(max_examples=draws(50))
def test_slerp_is_uniform_and_takes_the_shorter_way(seed: int, share: float, tiny: float) -> None:
    a, b = random_rotations(2, seed)
    way = float(angle_between_deg(a, b))
    for end in (b, -b):
        assert abs(angle_between_deg(a, slerp(a, end, share)) - share * way) < 1e-12
    close = quaternion_multiply(a, quaternion_exp([tiny, 0, 0]))
    assert abs(angle_between_deg(a, slerp(a, close, share)) - np.degrees(share * tiny)) < 1e-13


def test_equal_and_different_ends_may_stand_side_by_side() -> None:
    a, b = random_rotations(4, 5), random_rotations(4, 6)
    b[1], b[3] = a[1], -a[3]
    found = slerp(a, b, 0.3)
    assert np.isfinite(found).all()
    for index in range(4):
        assert np.abs(found[index] - slerp(a[index], b[index], 0.3)).max() <= EPS


def test_slerp_meets_its_ends_bit_for_bit() -> None:
    a, b = random_rotations(300), random_rotations(300, 1)
    assert (slerp(a, b, 0.0) == a).all()
    assert (slerp(a, b, 1.0) == b).all()
    assert np.abs(slerp(a, a, 0.3) - a).max() <= EPS


def test_normalise_is_idempotent_and_canonical() -> None:
    given = np.random.default_rng(0).normal(size=(100, 4)) * 10.0 ** np.linspace(-300, 150, 100)[:, None]
    unit = quaternion_normalise(given)
    assert np.abs(np.linalg.norm(unit, axis=1) - 1).max() < 4 * EPS
    assert (unit[:, 0] >= 0).all()
    assert (quaternion_normalise(unit) == unit).all()
    assert quaternion_normalise([-0.0, -1.0, 0.0, 0.0]).tobytes() == np.array([0.0, 1.0, 0.0, 0.0]).tobytes()
    assert quaternion_normalise([0.0, 0.0, -3.0, 4.0]).tolist() == [0.0, 0.0, 0.6, -0.8]


@pytest.mark.parametrize("bad", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 0]])
def test_what_is_no_rotation_is_named(bad: list[float]) -> None:
    given = np.tile([1.0, 0, 0, 0], (5, 1))
    given[3] = bad
    with pytest.raises(UsageError, match=r"row 3"):
        quaternion_normalise(given)
    with pytest.raises(UsageError, match=r"row 3.*quaternion_normalise"):
        rotate(given, [1.0, 0, 0])


def test_a_quaternion_that_is_not_unit_is_refused_not_used() -> None:
    for function in (quaternion_inverse, quaternion_log, matrix_from_quaternion, heading_deg):
        with pytest.raises(UsageError, match="unit length"):
            function([1.0, 1e-3, 0, 0])


@pytest.mark.parametrize(
    "matrix", [2 * np.eye(3), np.diag([1.0, 1, -1]), np.zeros((3, 3)), np.full((3, 3), np.nan)], ids=str
)
def test_a_matrix_that_is_no_rotation_is_refused(matrix: np.ndarray) -> None:
    with pytest.raises(UsageError, match="row 1"):
        quaternion_from_matrix(np.stack((np.eye(3), matrix)))


def test_a_rounded_matrix_gives_the_nearest_rotation() -> None:
    exact = random_rotations(50)
    rounded = np.round(matrix_from_quaternion(exact), 5)
    ours = quaternion_from_matrix(rounded)
    left, _, right = np.linalg.svd(rounded)
    assert np.abs(matrix_from_quaternion(ours) - left @ right).max() < 1e-14
    assert angle_between_deg(ours, exact).max() < 1e-3


def test_headings() -> None:
    assert np.allclose(quaternion_from_heading_pitch_roll(90.0), [1, 0, 0, 0], atol=EPS)
    forward = rotate(quaternion_from_heading_pitch_roll([0.0, 90.0, 180.0, 270.0]), [1.0, 0, 0])
    assert np.allclose(forward, [[0, 1, 0], [1, 0, 0], [0, -1, 0], [-1, 0, 0]], atol=4 * EPS)
    assert rotate(quaternion_from_heading_pitch_roll(30.0, pitch_deg=5.0), [1.0, 0, 0])[2] > 0
    assert rotate(quaternion_from_heading_pitch_roll(30.0, roll_deg=5.0), [0, 1.0, 0])[2] > 0


@given(st.floats(0, 360, exclude_max=True), st.floats(-89, 89), st.floats(-180, 180))
def test_heading_round_trip_and_scipy(heading: float, pitch: float, roll: float) -> None:
    ours = quaternion_from_heading_pitch_roll(heading, pitch, roll)
    theirs = Rotation.from_euler("ZYX", [90 - heading, -pitch, roll], degrees=True)
    assert angle_between_deg(ours, theirs.as_quat(scalar_first=True)) < 1e-12
    back = heading_deg(ours)
    assert 0 <= back < 360
    assert abs((back - heading + 180) % 360 - 180) < 1e-11


def test_empty_and_one() -> None:
    assert rotate(np.empty((0, 4)), np.empty((0, 3))).shape == (0, 3)
    assert quaternion_normalise(np.empty((0, 4))).shape == (0, 4)
    assert quaternion_from_matrix(np.empty((0, 3, 3))).shape == (0, 4)
    assert rotate([1.0, 0, 0, 0], [1.0, 2, 3]).tolist() == [1, 2, 3]


def test_points_that_are_not_finite_stay_so() -> None:
    turned = rotate([1.0, 0, 0, 0], [[1.0, 2, 3], [np.nan, 0, 0]])
    assert np.isfinite(turned[0]).all()
    assert not np.isfinite(turned[1]).all()


def test_blocks_change_no_bit() -> None:
    count, part = 30_000, 2_000
    a, b = random_rotations(count), random_rotations(count, 1)
    share = np.random.default_rng(2).random(count)
    points = np.random.default_rng(3).normal(size=(2, count, 3))

    def results(rows: slice) -> list[np.ndarray]:
        return [
            quaternion_multiply(a[rows], b[rows]),
            slerp(a[rows], b[rows], share[rows]),
            rotate(a[rows], points[:, rows]),
            rotate(a[:2, None], points[:, rows]),
        ]

    # Each part is less than a block.
    parts = [results(slice(first, first + part)) for first in range(0, count, part)]
    for whole, *pieces in zip(results(slice(None)), *parts, strict=True):
        assert pieces[0].size < BLOCK_VALUES < whole.size / 2
        assert np.concatenate(pieces, axis=-2).tobytes() == whole.tobytes()
