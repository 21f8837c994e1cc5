"""Readouts and time offsets from exact tracks of rolling shutters on a bend of changing speed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mirror.calibration.equations import JointProblem
from mirror.calibration.estimate import estimate_rotations
from mirror.calibration.refinement.adjustment import adjust_rigs
from mirror.calibration.refinement.rigs import FeatureTracks, MovingRigs
from mirror.calibration.rig import TimePrior, TrackedRig
from mirror.calibration.shutters import estimate_shutters
from mirror.calibration.tracking import PairTracks
from mirror.geometry import Poses, quaternion_from_matrix
from mirror.geometry.rolling_shutter import RollingShutter, project_rolling
from tests.calibration.exact_rig import CAMERAS, about_z, mountings
from tests.calibration.moving_rigs import stack

FRAMES, STEP_S = 14, 0.4


@cache
def _way(turning: bool) -> np.ndarray:
    """Times in seconds, headings in radians, x and y in metres, (4, 4001), of a drive of 6 m/s and more.

    Its rate of turn grows from 0 to 40 degrees a second and falls again.
    """
    grid = np.linspace(-0.2, FRAMES * STEP_S + 0.2, 4001)
    rate = (
        np.radians(40.0) * np.sin(np.pi * np.clip(grid / (FRAMES * STEP_S), 0.0, 1.0)) ** 2 if turning else 0.0 * grid
    )
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(grid))])
    speed = 6.0 + (0.8 * grid if turning else 0.0 * grid)
    steps = [speed * np.cos(yaw), speed * np.sin(yaw)]
    x, y = (np.concatenate([[0.0], np.cumsum(0.5 * (one[1:] + one[:-1]) * np.diff(grid))]) for one in steps)
    return np.stack([grid, yaw, x, y])


def _poses(times_s: np.ndarray, turning: bool) -> Poses:
    """Poses of the drive at times."""
    grid, yaw, x, y = _way(turning)
    heading = np.degrees(np.interp(times_s, grid, yaw))
    places = np.stack([np.interp(times_s, grid, x), np.interp(times_s, grid, y), 0.0 * times_s], axis=1)
    return Poses(quaternion_from_matrix(about_z(heading)), places)


def rolling_rig(
    shutters: dict[str, RollingShutter], offset_ms: float = 0.0, noise_px: float = 0.15, turning: bool = True
) -> TrackedRig:
    """A rig whose tracks are those of true shutters and of a clock that is late; it declares global shutters."""
    rng = np.random.default_rng(5)
    stamps = STEP_S * np.arange(FRAMES)
    poses, true = _poses(stamps, turning), mountings()
    middle = poses.translation.mean(axis=0)
    around, distance = rng.uniform(0.0, 2.0 * np.pi, 900), rng.uniform(8.0, 45.0, 900)
    world = middle + np.stack(
        [distance * np.cos(around), distance * np.sin(around), rng.uniform(-0.5, 10.0, 900)], axis=1
    )
    pairs, twists = [], {}
    for name, camera in CAMERAS.items():
        shutter = shutters.get(name, RollingShutter("global", 0, camera.width_px, camera.height_px))
        seen = []
        for stamp in stamps:

            def points_at(offsets_ns: np.ndarray, stamp: float = float(stamp), name: str = name) -> np.ndarray:
                cameras = _poses(stamp + 1e-3 * offset_ms + 1e-9 * offsets_ns, turning) @ true[name]
                return np.asarray(cameras.inverse().transform(world[:, None])[:, 0])

            seen.append(project_rolling(camera, shutter, len(world), points_at))
        for frame in range(FRAMES - 1):
            both = seen[frame][1] & seen[frame + 1][1]
            uv = [seen[at][0][both] + rng.normal(0.0, noise_px, (both.sum(), 2)) for at in (frame, frame + 1)]
            pairs.append(PairTracks(name, frame, frame + 1, uv[0], uv[1]))
        ends = [_poses(stamps + side, turning) for side in (-0.05, 0.05)]
        twists[name] = (ends[0].inverse() @ ends[1]).log() / 0.1
    return TrackedRig(CAMERAS, true, stamps, dict.fromkeys(CAMERAS, poses), pairs, twists)


def shutter(name: str, direction: str, readout_ms: float) -> RollingShutter:
    camera = CAMERAS[name]
    return RollingShutter(direction, round(1e6 * readout_ms), camera.width_px, camera.height_px)  # type: ignore[arg-type]


TRUE = {
    "ahead": shutter("ahead", "top_to_bottom", 30.0),
    "left": shutter("left", "right_to_left", 20.0),
    "right": shutter("right", "bottom_to_top", 25.0),
}


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


def _moving_rigs(shutters: dict[str, RollingShutter]) -> tuple[MovingRigs, FeatureTracks]:
    """The same drive as features of 400 points; the rigs state no shutters."""
    rng = np.random.default_rng(7)
    frames, step_s, count = 10, 0.35, len(CAMERAS)
    stamps, true = 0.6 + step_s * np.arange(frames), mountings()
    poses = _poses(stamps, True)
    around, distance = rng.uniform(0.0, 2.0 * np.pi, 400), rng.uniform(6.0, 30.0, 400)
    around = np.stack([distance * np.cos(around), distance * np.sin(around), rng.uniform(-0.5, 8.0, 400)], axis=1)
    world = poses.translation.mean(axis=0) + around
    rows, twist = [], np.empty((frames * count, 6))
    ends = [_poses(stamps + side, True) for side in (-0.05, 0.05)]
    for number, (name, camera) in enumerate(CAMERAS.items()):
        for frame, stamp in enumerate(stamps):

            def points_at(offsets_ns: np.ndarray, stamp: float = float(stamp), name: str = name) -> np.ndarray:
                cameras = _poses(stamp + 1e-9 * offsets_ns, True) @ true[name]
                return np.asarray(cameras.inverse().transform(world[:, None])[:, 0])

            uv, valid, _ = project_rolling(camera, shutters[name], len(world), points_at)
            rows += [(point, frame * count + number, *uv[point]) for point in np.flatnonzero(valid)]
            twist[frame * count + number] = ((ends[0].inverse() @ ends[1]).log() / 0.1)[frame]
    table = np.array(sorted(rows))
    table = table[np.bincount(table[:, 0].astype(int))[table[:, 0].astype(int)] >= 2]
    track = np.unique(table[:, 0], return_inverse=True)[1].astype(np.int64)
    tracks = FeatureTracks(track, table[:, 1].astype(np.int64), table[:, 2:], np.ones(len(table)))
    frame = np.repeat(np.arange(frames), count)
    mounted = stack([true[name] for name in CAMERAS])
    rigs = MovingRigs(
        list(CAMERAS.values()), mounted, poses[frame], frame, np.tile(np.arange(count), frames), stamps,
        np.zeros(frames, np.int64), twist,
    )  # fmt: skip
    return rigs, tracks


def test_an_adjustment_with_the_declared_shutters_keeps_exact_mountings() -> None:
    rigs, tracks = _moving_rigs(TRUE)
    errors = []
    for shutters in ([TRUE[name] for name in CAMERAS], []):
        found = adjust_rigs(replace(rigs, shutters=shutters), tracks)
        turn = (rigs.ego_SE3_camera.inverse() @ found.ego_SE3_camera).log()[:, :3]
        errors.append((float(np.degrees(np.abs(turn)).max()), float(np.median(found.residual_px))))
    assert errors[0][0] < 0.02 and errors[0][1] < 0.05
    assert errors[1][0] > 3.0 * errors[0][0] and errors[1][1] > 3.0 * errors[0][1]
