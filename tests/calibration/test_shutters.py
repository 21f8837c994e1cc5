"""Readouts and time offsets from exact tracks of rolling shutters on a bend of changing speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mirror.calibration.equations import JointProblem
from mirror.calibration.estimate import estimate_rotations
from mirror.calibration.refinement.adjustment import Adjuster, RigState, adjust_rigs
from mirror.calibration.refinement.rigs import RefinementPrior
from mirror.calibration.refinement.shutters import estimate_times
from mirror.calibration.refinement.triangulation import triangulate
from mirror.calibration.rig import TimePrior, TrackedRig
from mirror.calibration.shutters import estimate_shutters
from mirror.errors import UsageError
from mirror.geometry.rolling_shutter import RollingShutter
from tests.calibration.exact_rig import CAMERAS
from tests.calibration.rolling_rig import TRUE, rolling_features, rolling_rig, shutter


@pytest.fixture(scope="module")
def rig() -> TrackedRig:
    return rolling_rig(TRUE, offset_ms=6.0)


@pytest.mark.parametrize("noise_px", [0.0, 0.15])
def test_readout_direction_and_offset_are_found(rig: TrackedRig, noise_px: float) -> None:
    """Exact tracks give them within 0.3 ms; with noise each is within three of its standard deviations."""
    tracked = rig if noise_px else rolling_rig(TRUE, offset_ms=6.0, noise_px=0.0)
    for declared in ({}, TRUE):
        for one in estimate_shutters(replace(tracked, shutters=declared)):
            true = TRUE[one.camera]
            assert one.direction == true.direction
            readout_error, offset_error = abs(one.readout_ms - 1e-6 * true.readout_ns), abs(one.offset_ms - 6.0)
            assert offset_error < 1.0 and one.offset_known
            assert readout_error < (3.0 * one.readout_sigma_ms if noise_px else 0.3)
            assert one.readout_sigma_ms < 4.0
            assert (one.problem is None) == bool(declared)


@pytest.mark.parametrize("seed", [0, 1])
def test_intervals_cover_where_a_camera_hardly_shows_its_readout(seed: int) -> None:
    """The camera on the right: with these seeds its readout is 8.2 and 2.3 ms from the truth."""
    rng, exact = np.random.default_rng(seed), rolling_rig(TRUE, offset_ms=6.0, noise_px=0.0)
    pairs = [
        replace(
            pair,
            first_px=pair.first_px + rng.normal(0.0, 0.15, pair.first_px.shape),
            second_px=pair.second_px + rng.normal(0.0, 0.15, pair.second_px.shape),
        )
        for pair in exact.pairs
    ]
    for one in estimate_shutters(replace(exact, pairs=pairs, shutters=TRUE)):
        assert abs(one.readout_ms - 1e-6 * TRUE[one.camera].readout_ns) < 3.0 * one.readout_sigma_ms
        assert abs(one.offset_ms - 6.0) < 3.0 * one.offset_sigma_ms
        assert one.problem is None


def test_a_wrong_declaration_is_named(rig: TrackedRig) -> None:
    wrong = {"ahead": shutter("ahead", "bottom_to_top", 30.0), "left": shutter("left", "right_to_left", 10.0)}
    ahead, left, right = estimate_shutters(replace(rig, shutters=wrong))
    assert ahead.problem is not None and "declares bottom_to_top, 30.0 ms" in ahead.problem
    assert "images show top_to_bottom, " in ahead.problem
    assert left.problem is not None and "declares right_to_left, 10.0 ms" in left.problem
    assert right.problem is not None and "declares a global shutter" in right.problem


def test_tracks_with_much_noise_name_no_shutter() -> None:
    """With 0.4 px a third of the errors are beyond two deviations of the scatter, so none is stated."""
    wrong = {name: shutter(name, "bottom_to_top", 30.0) for name in TRUE}
    for one in estimate_shutters(replace(rolling_rig(TRUE, offset_ms=6.0, noise_px=0.4), shutters=wrong)):
        assert not one.readout_known and not one.offset_known
        assert one.problem is None


def test_on_a_straight_road_times_are_intervals(rig: TrackedRig) -> None:
    for one in estimate_shutters(rolling_rig(TRUE, offset_ms=6.0, turning=False)):
        assert not one.offset_known and one.offset_sigma_ms > 5.0
        assert one.problem is None


def test_declared_shutters_keep_mountings_right(rig: TrackedRig) -> None:
    honest = rolling_rig(TRUE)
    stated, unstated = (estimate_rotations(replace(honest, shutters=declared)) for declared in (TRUE, {}))
    worst = [max(float(np.abs(one.error_deg).max()) for one in estimates) for estimates in (stated, unstated)]
    assert worst[0] < 0.1
    assert worst[1] > 2.0 * worst[0]


def test_derivatives_by_the_times_are_those_of_finite_differences(rig: TrackedRig) -> None:
    problem = JointProblem(replace(rig, shutters=TRUE), times=TimePrior())
    unknowns = np.random.default_rng(0).normal(0.0, 1e-4, problem.size)
    # the loss's weights make the gradient that of the cost; Sampson's denominator counts as constant
    state = problem._linearise(problem.mountings, unknowns)
    for column in (*problem.time_columns.ravel(), problem.scale_column - 6, problem.scale_column - 2, 3, 8):
        step = np.zeros(problem.size)
        step[column] = 1e-6
        costs = [problem._linearise(problem.mountings, unknowns + sign * step).cost for sign in (1, -1)]
        slope, size = (costs[0] - costs[1]) / 2e-6, float(np.abs(state.gradient).max())
        assert state.gradient[column] == pytest.approx(slope, rel=0.02, abs=1e-3 * size)


def test_an_adjustment_with_the_declared_shutters_keeps_exact_mountings() -> None:
    rigs, tracks = rolling_features(TRUE, points=400, frames=10)
    errors = []
    for shutters in ([TRUE[name] for name in CAMERAS], []):
        found = adjust_rigs(replace(rigs, shutters=shutters), tracks)
        turn = (rigs.ego_SE3_camera.inverse() @ found.ego_SE3_camera).log()[:, :3]
        errors.append((float(np.degrees(np.abs(turn)).max()), float(np.median(found.residual_px))))
    assert errors[0][0] < 0.02 and errors[0][1] < 0.05
    assert errors[1][0] > 3.0 * errors[0][0] and errors[1][1] > 3.0 * errors[0][1]


def _true_times_ms(offset_ms: float) -> np.ndarray:
    """Offset and readout in the true direction (C, 2)."""
    return np.array([[offset_ms, 1e-6 * TRUE[name].readout_ns] for name in CAMERAS])


@pytest.mark.parametrize("declared", [{}, TRUE], ids=["undeclared", "declared"])
def test_features_of_many_images_show_readout_and_offset_within_a_millisecond(
    declared: dict[str, RollingShutter],
) -> None:
    """Noise of 0.4 px; also the camera on the right, of which pairs of images show the readout to 7 ms."""
    rigs, tracks = rolling_features(TRUE, 6.0, 0.4, seed=3, points=900)
    stated = replace(rigs, shutters=[declared[name] for name in CAMERAS if name in declared])
    found = estimate_times(stated, tracks, list(CAMERAS))
    assert [one.direction for one in found] == [TRUE[name].direction for name in CAMERAS]
    values = np.array([[one.offset_ms, one.readout_ms] for one in found])
    sigma = np.array([[one.offset_sigma_ms, one.readout_sigma_ms] for one in found])
    errors = np.abs(values - _true_times_ms(6.0))
    assert errors.max() < 1.0 and sigma.max() < 1.0
    assert (errors < 3.0 * sigma).all()
    assert all((one.problem is None) == bool(declared) for one in found)


def test_exact_features_show_the_times_exactly() -> None:
    rigs, tracks = rolling_features(TRUE, 6.0, points=300)
    found = estimate_times(rigs, tracks, list(CAMERAS))
    values = np.array([[one.offset_ms, one.readout_ms] for one in found])
    # velocities between poses 0.05 s before and after an exposure miss what they change in between
    assert np.abs(values - _true_times_ms(6.0)).max() < 0.15


def test_without_turns_the_offset_has_the_interval_of_its_prior() -> None:
    rigs, tracks = rolling_features(TRUE, 6.0, 0.2, points=300, turning=False)
    for one in estimate_times(rigs, tracks, list(CAMERAS)):
        assert not one.offset_known and abs(one.offset_ms - 6.0) < 3.0 * one.offset_sigma_ms


def test_times_without_velocities_are_refused() -> None:
    rigs, tracks = rolling_features(TRUE, points=30, frames=3)
    with pytest.raises(UsageError, match="no velocities"):
        estimate_times(replace(rigs, ego_twist=None), tracks, list(CAMERAS))


def test_the_derivatives_by_the_times_are_those_of_the_exposed_features() -> None:
    rigs, tracks = rolling_features(TRUE, 6.0, points=40, frames=4)
    adjuster = Adjuster(rigs, RefinementPrior(), TimePrior())
    points, _ = triangulate(rigs, tracks)
    known = np.asarray(np.isfinite(points).all(axis=1))
    mounts = adjuster.mounts
    state = RigState(
        np.tile(np.eye(3), (4, 1, 1)), np.zeros((4, 3)), mounts, rigs.ego_SE3_camera.translation,
        np.zeros((3, 3)), np.zeros((3, 3)), np.where(known[:, None], points, [30.0, 0.0, 2.0]),
    )  # fmt: skip

    def residuals(times_s: np.ndarray) -> np.ndarray:
        """Residuals of features that are exposed at some times."""
        at = replace(state, times_s=times_s)
        adjuster.expose(at, tracks)
        return adjuster.residuals(at, tracks)

    step = 1e-4 * np.eye(9).reshape(9, 3, 3)
    differences = np.stack([(residuals(h) - residuals(-h)) / 2e-4 for h in step], axis=-1)
    residuals(np.zeros((3, 3)))
    late = adjuster.features(tracks).late
    own = 3 * rigs.mounting[tracks.image][:, None] + np.arange(3)
    expected = np.take_along_axis(differences, own[:, None, :], axis=2)
    assert np.abs(late - expected).max() < 1e-5 * np.abs(expected).max()
    assert np.abs(expected).max() > 100.0
