"""The joint estimate on exact and noisy tracks, against injected errors and finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mirror.calibration.equations import JointProblem, exp_rotations
from mirror.calibration.estimate import ObservingConditions, estimate_rotations, explain
from mirror.calibration.rig import PosePrior, ScalePrior
from mirror.errors import UsageError
from mirror.geometry import Poses
from tests.calibration.exact_rig import CAMERAS, exact_rig, mountings

ERRORS = {"ahead": np.array([0.3, -0.5, 0.4]), "left": np.array([-0.6, 0.2, 0.1]), "right": np.array([0.0, 0.05, -0.9])}
TURNING = ObservingConditions(80.0, 22.0, dict.fromkeys(CAMERAS, 120.0), dict.fromkeys(CAMERAS, 500.0))


def test_exact_tracks_give_the_injected_errors() -> None:
    estimates = estimate_rotations(exact_rig(80.0, errors_deg=ERRORS))
    for one in estimates:
        assert np.abs(one.error_deg - ERRORS[one.camera]).max() < 2e-3
        assert one.observable.all()
        assert one.residual_px < 1e-3
        assert explain(one, TURNING) is None


def test_the_correction_removes_the_error() -> None:
    rig = exact_rig(80.0, errors_deg=ERRORS)
    turns = {one.camera: one.rotation_rad for one in estimate_rotations(rig)}
    corrected = {
        name: mounting @ Poses.exp(np.concatenate([turns[name], np.zeros(3)])[None])
        for name, mounting in rig.ego_SE3_camera.items()
    }
    again = estimate_rotations(replace(rig, ego_SE3_camera=corrected))
    assert max(np.abs(one.error_deg).max() for one in again) < 1e-3


def test_on_a_straight_road_only_roll_is_unobservable() -> None:
    estimates = estimate_rotations(exact_rig(0.0, frames=24, errors_deg=ERRORS, noise_px=0.1, points=450))
    for one in estimates:
        assert one.observable.tolist() == [False, True, True]
        assert np.abs(one.error_deg - ERRORS[one.camera])[1:].max() < 0.08
        assert explain(one, replace(TURNING, turned_deg=0.0)) == "straight driving"
        assert one.angle_deg == pytest.approx(np.linalg.norm(one.error_deg[1:]))


def test_intervals_cover_the_truth() -> None:
    inside = []
    for seed in range(6):
        rig = exact_rig(80.0, errors_deg=ERRORS, noise_px=0.2, points=400, seed=seed)
        rng, prior = np.random.default_rng(seed), PosePrior()
        shape = (len(rig.time_s), 3)
        turn = rng.normal(0.0, np.radians(prior.attitude_deg), shape)
        covariance = np.linalg.inv(prior.position_information(rig.time_s))
        shift = np.linalg.cholesky(covariance) @ rng.normal(size=shape)
        poses = next(iter(rig.world_SE3_ego.values()))
        noisy = poses @ Poses.exp(np.concatenate([turn, np.zeros(shape)], axis=1))
        noisy = Poses(noisy.rotation, noisy.translation + shift)
        estimates = estimate_rotations(replace(rig, world_SE3_ego=dict.fromkeys(CAMERAS, noisy)), tracker_bias_px=0.0)
        inside += [np.abs(one.error_deg - ERRORS[one.camera]) < 1.96 * one.sigma_deg for one in estimates]
    assert 0.8 <= np.mean(inside) <= 1.0


def test_wrong_tracks_have_little_influence() -> None:
    rig = exact_rig(80.0, errors_deg=ERRORS, noise_px=0.1)
    rng = np.random.default_rng(4)
    pairs = []
    for pair in rig.pairs:
        wrong = rng.random(len(pair)) < 0.1
        pairs.append(replace(pair, second_px=pair.second_px + wrong[:, None] * rng.normal(0.0, 20.0, (len(pair), 2))))
    for one in estimate_rotations(replace(rig, pairs=pairs)):
        assert np.abs(one.error_deg - ERRORS[one.camera]).max() < 0.08


def test_moving_clouds_are_left_out() -> None:
    rig = exact_rig(80.0, errors_deg=ERRORS)
    pairs = []
    for pair in rig.pairs:
        camera, (one, two) = (
            CAMERAS[pair.camera],
            (rig.world_SE3_ego[pair.camera][at] for at in (pair.first, pair.second)),
        )
        true = mountings()[pair.camera]
        ways = camera.unproject(np.random.default_rng(pair.first).uniform((100, 20), (860, 200), (60, 2))).direction
        world = (one @ true).transform(1e5 * ways)[0]
        # The wind turns all clouds by 0.15 degrees between two frames.
        drifted = Poses.exp([[0.0, 0.0, np.radians(0.15), 0.0, 0.0, 0.0]]).transform(world)[0]
        seen = [camera.project((pose @ true).inverse().transform(p)[0]) for pose, p in ((one, world), (two, drifted))]
        valid = seen[0].valid & seen[1].valid
        pairs.append(replace(pair, first_px=np.concatenate([pair.first_px, seen[0].uv_px[valid]]),
                             second_px=np.concatenate([pair.second_px, seen[1].uv_px[valid]])))  # fmt: skip
    for one in estimate_rotations(replace(rig, pairs=pairs)):
        assert np.abs(one.error_deg - ERRORS[one.camera]).max() < 5e-3


@pytest.mark.parametrize("prior", [PosePrior(), PosePrior(attitude_deg=0.1)])
def test_a_wrong_focal_length_in_a_bend_is_no_rotation(prior: PosePrior) -> None:
    rig = exact_rig(98.0, errors_deg=ERRORS, noise_px=0.1, points=500)
    cameras = {
        name: replace(camera, fx_px=camera.fx_px * scale, fy_px=camera.fy_px * scale)
        for (name, camera), scale in zip(rig.cameras.items(), (1.007, 0.993, 1.01))
    }
    poses = {
        name: Poses(one.rotation, 1.006 * (one.translation - one.translation[0]))
        for name, one in rig.world_SE3_ego.items()
    }
    for one in estimate_rotations(replace(rig, cameras=cameras, world_SE3_ego=poses), prior):
        assert (np.abs(one.error_deg - ERRORS[one.camera]) < 2.0 * one.sigma_deg).all()
        assert np.abs(one.error_deg - ERRORS[one.camera])[:2].max() < 0.05
        true = 100.0 * (cameras[one.camera].fx_px / CAMERAS[one.camera].fx_px - 1.0)
        assert abs(one.focal.error_percent - true) < 3.0 * one.focal.sigma_percent < 0.6
        assert abs(one.way.error_percent - 0.6) < 3.0 * one.way.sigma_percent
        assert sum(one.variance_share.values()) == pytest.approx(np.ones(3))


def test_scales_that_are_known_exactly_turn_the_cameras() -> None:
    rig = exact_rig(98.0, noise_px=0.1, points=500)
    cameras = {name: replace(one, fx_px=1.007 * one.fx_px, fy_px=1.007 * one.fy_px) for name, one in CAMERAS.items()}
    wrong = replace(rig, cameras=cameras)
    known = estimate_rotations(wrong, scales=ScalePrior(1e-3, 1e-3))
    free = estimate_rotations(wrong)
    assert max(np.abs(one.error_deg / one.sigma_deg).max() for one in known) > 4.0
    assert max(np.abs(one.error_deg / one.sigma_deg).max() for one in free) < 2.0


@pytest.mark.parametrize("value", [0.0, -1.0, 11.0, float("nan")])
def test_priors_of_scales_are_percents(value: float) -> None:
    with pytest.raises(UsageError, match="at most 10"):
        ScalePrior(focal_percent=value)


def test_distances_are_those_of_the_points() -> None:
    rig = exact_rig(80.0)
    distances = JointProblem(rig).solve().distances_m()
    # The points lie 8 to 45 m around the middle of a way of 22 m.
    assert 2.0 < np.median(distances) < 45.0
    assert (distances < 60.0).mean() > 0.98


def test_derivatives_are_those_of_the_residuals() -> None:
    problem = JointProblem(exact_rig(80.0, frames=3, points=150), PosePrior(), loss_px=1e3)
    rng = np.random.default_rng(8)
    start, unknowns = problem.mountings, 1e-2 * rng.normal(size=problem.size)
    state = problem._linearise(start, unknowns)
    scales = np.arange(problem.scale_column, problem.size)
    for column in [*rng.choice(problem.scale_column, 12, replace=False), *scales]:
        step = np.zeros(len(unknowns))
        step[column] = 1e-7
        # The scale of Sampson's distance counts as constant, so both residuals are compared at the middle's scale.
        costs = [problem._linearise(start, unknowns + sign * step) for sign in (1.0, -1.0)]
        difference = (costs[0].cost - costs[1].cost) / 2e-7
        assert state.gradient[column] == pytest.approx(difference, rel=0.25, abs=0.02 * np.abs(state.gradient).max())


def test_a_camera_without_tracks_is_unobservable() -> None:
    rig = exact_rig(80.0)
    estimates = estimate_rotations(replace(rig, pairs=[pair for pair in rig.pairs if pair.camera != "left"]))
    left = next(one for one in estimates if one.camera == "left")
    assert (left.sigma_deg > 1.0).all()
    assert left.tracks == 0
    assert np.isnan(left.residual_px)
    assert np.isnan(left.angle_deg)
    dark = replace(TURNING, brightness={"left": 10.0})
    assert explain(left, dark) == "no tracks: night"
    assert explain(left, replace(TURNING, corners={"left": 3.0})) == "no tracks: no texture"


def test_a_standing_vehicle_is_refused() -> None:
    rig = exact_rig(80.0)
    still = Poses(np.tile([1.0, 0.0, 0.0, 0.0], (12, 1)), np.zeros((12, 3)))
    with pytest.raises(UsageError, match="vehicle moves"):
        estimate_rotations(replace(rig, world_SE3_ego=dict.fromkeys(CAMERAS, still)))
    with pytest.raises(UsageError, match="no tracks"):
        estimate_rotations(replace(rig, pairs=[]))


def test_a_huge_offset_of_the_world_changes_nothing() -> None:
    rig = exact_rig(80.0, errors_deg=ERRORS)
    far = {n: Poses(p.rotation, p.translation + np.array([4e6, -3e6, 100.0])) for n, p in rig.world_SE3_ego.items()}
    one, other = estimate_rotations(rig), estimate_rotations(replace(rig, world_SE3_ego=far))
    assert max(np.abs(a.error_deg - b.error_deg).max() for a, b in zip(one, other)) < 1e-5


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_priors_are_positive(value: float) -> None:
    with pytest.raises(UsageError, match="above 0"):
        PosePrior(attitude_deg=value)


def test_rotation_matrices_are_the_exponential() -> None:
    from scipy.spatial.transform import Rotation

    vectors = np.random.default_rng(1).normal(size=(20, 3))
    assert np.abs(exp_rotations(vectors) - Rotation.from_rotvec(vectors).as_matrix()).max() < 1e-14
