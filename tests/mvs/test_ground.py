"""Tests the ground against surfaces in closed form and the ground of the synthetic street."""

from __future__ import annotations

import numpy as np
import pytest

from hybridworldsim.mvs.ground import compute_wheel_contacts, fit_ground
from mirror.errors import UsageError
from mirror.geometry.poses import Poses
from mirror.synth.fleet.drives import make_drives


def line(length_m: float = 80.0, step_m: float = 0.5) -> np.ndarray:
    return np.arange(0.0, length_m, step_m)


def test_slope_and_its_normal_are_fitted() -> None:
    along = line()
    driven = np.concatenate([np.column_stack([along, np.full_like(along, y), 0.03 * along]) for y in (-2.0, 0.0, 2.0)])
    ground = fit_ground(driven)
    at = np.column_stack([np.linspace(10.0, 70.0, 7), np.linspace(-2.0, 2.0, 7)])
    np.testing.assert_allclose(ground.height(at), 0.03 * at[:, 0], atol=0.015)
    expected = np.array([-0.03, 0.0, 1.0]) / np.hypot(0.03, 1.0)
    np.testing.assert_allclose(ground.normal(at), np.tile(expected, (7, 1)), atol=0.012)


def test_normal_matches_the_gradient() -> None:
    along = line()
    ground = fit_ground(np.column_stack([along, 5.0 * np.sin(along / 15.0), np.sin(along / 10.0)]))
    at = np.random.default_rng(0).uniform((0.0, -8.0), (80.0, 8.0), (50, 2))
    step = 1e-5
    slope = [(ground.height(at + step * axis) - ground.height(at - step * axis)) / (2 * step) for axis in np.eye(2)]
    expected = np.column_stack([-slope[0], -slope[1], np.ones(50)])
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(ground.normal(at), expected, atol=1e-6)


def test_ground_is_level_and_finite_far_away() -> None:
    along = line()
    ground = fit_ground(np.column_stack([along, 0.0 * along, 0.02 * along]))
    far = np.array([[1e6, 0.0], [-1e6, 1e6], [40.0, -1e5]])
    assert np.isfinite(ground.height(far)).all() and np.abs(ground.height(far)).max() < 3.0
    np.testing.assert_allclose(ground.normal(far)[:2], [[0.0, 0.0, 1.0]] * 2, atol=1e-12)


def test_points_above_the_ground_do_not_lift_it() -> None:
    rng = np.random.default_rng(2)
    along = line()
    driven = np.column_stack([along, 0.0 * along, 0.0 * along])
    # A pavement 0.12 m high at 5 to 8 m, with walls and cars on it.
    pavement = np.column_stack([rng.uniform(0, 80, 2000), rng.uniform(5, 8, 2000), rng.normal(0.12, 0.03, 2000)])
    wall = np.column_stack([rng.uniform(0, 80, 1500), rng.uniform(5, 8, 1500), rng.uniform(0.2, 9.0, 1500)])
    at = np.column_stack([np.linspace(10, 70, 13), np.full(13, 6.5)])
    ground = fit_ground(driven, np.concatenate([pavement, wall, [[40.0, 1.0, np.nan]]]))
    assert np.abs(ground.height(at) - 0.12).max() < 0.05
    assert np.abs(ground.height(driven[:, :2])).max() < 0.03
    assert np.abs(fit_ground(driven).height(at)).max() < 0.02


def test_synthetic_street_is_fitted_to_centimetres() -> None:
    drive = make_drives("reconstruction", 0, scenes=1, traversals=1)[1][0]
    stamps = drive.condition.start_ns + np.arange(0, 60_000_000_000, 100_000_000)
    poses = drive.world_SE3_ego(stamps)
    poses = poses[np.linalg.norm(poses.translation[:, :2], axis=1) < 45.0]
    ground = fit_ground(compute_wheel_contacts(poses))
    left = poses.matrix()[:, :2, 1]
    for offset_m, max_error_m in ((0.0, 0.02), (1.0, 0.04)):
        at = poses.translation[:, :2] + offset_m * left
        error = np.abs(ground.height(at) - drive.world.height_m(at[:, 0], at[:, 1]))
        assert np.median(error) < max_error_m


def test_one_pose_with_a_huge_offset() -> None:
    position = np.array([[4.0e5, -2.0e5, 1234.5]])
    ground = fit_ground(position)
    np.testing.assert_allclose(ground.height(position[:, :2]), 1234.5, atol=1e-6)
    stationary = fit_ground(np.repeat(position, 500, axis=0))
    np.testing.assert_allclose(stationary.height(position[:, :2]), 1234.5, atol=1e-6)


@pytest.mark.parametrize("driven", [np.empty((0, 3)), np.full((4, 3), np.nan), np.array([[0.0, 0, 0], [1e5, 1e5, 0]])])
def test_input_without_a_fit_is_refused(driven: np.ndarray) -> None:
    with pytest.raises(UsageError):
        fit_ground(driven)


def test_wheel_contacts_lie_beside_the_middle_of_the_axle() -> None:
    quarter = Poses(np.array([[np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]]), np.array([[1.0, 2.0, 3.0]]))
    np.testing.assert_allclose(compute_wheel_contacts(quarter), [[1, 2, 3], [0.2, 2, 3], [1.8, 2, 3]], atol=1e-12)
