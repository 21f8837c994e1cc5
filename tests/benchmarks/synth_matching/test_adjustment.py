"""Tests of the rig adjustment on exact image points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("scipy", reason="scipy is absent: pip install '.[calibration]'")

from benchmarks.synth_matching.adjustment import Spread, adjust_rig
from benchmarks.synth_matching.benchmark import pose_errors
from benchmarks.synth_matching.features import Features
from benchmarks.synth_matching.tracks import Key, Rig, Tracks, triangulate_tracks
from mirror.arrays import Int64
from mirror.errors import UsageError
from mirror.geometry import Poses, quaternion_from_matrix
from mirror.geometry.cameras import Camera

CAMERAS = {
    "ahead": Camera("kannala_brandt", 960, 540, 420.0, 420.0, 481.0, 268.0, (-0.012, 0.004, -0.002, 0.0005)),
    "left": Camera("f_theta", 960, 540, 1.0, 1.0, 478.0, 271.0, (0.0, 430.0, 0.0, -15.0)),
    "right": Camera("brown_conrady", 960, 540, 430.0, 430.0, 480.0, 270.0, (-0.13, 0.012, 0.0003, -0.0002, 0.0)),
}
COLMAPS = {**CAMERAS, "left": Camera("pinhole", 960, 540, 430.0, 430.0, 478.0, 271.0)}
SPREAD = Spread(0.036, 3.5e-4, 7e-4, 0.004, 2e-4, 2e-4)


def true_rig(cameras: dict[str, Camera], frames: int = 8) -> Rig:
    """Three cameras of a vehicle that turns by 80 degrees on a radius of 8 m."""
    turn = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    mounts = Poses(quaternion_from_matrix(np.stack([about(yaw) @ turn for yaw in (0.0, 55.0, -55.0)])),
                   np.array([[1.8, 0.0, 1.4], [2.2, 0.9, 1.0], [2.2, -0.9, 1.0]]))  # fmt: skip
    yaws = np.linspace(0.0, 80.0, frames)
    places = 8.0 * np.stack([np.sin(np.radians(yaws)), 1.0 - np.cos(np.radians(yaws)), 0.0 * yaws], axis=1)
    return Rig(cameras, mounts, Poses(quaternion_from_matrix(np.stack([about(yaw) for yaw in yaws])), places))


def about(yaw_deg: float) -> np.ndarray:
    cos, sin = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def tracks_of(rig: Rig, count: int = 500) -> Tracks:
    """Exact image points of 3D points around the rig."""
    rng = np.random.default_rng(5)
    around, distance = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(12.0, 40.0, count)
    points = np.stack(
        [4.0 + distance * np.cos(around), 4.0 + distance * np.sin(around), rng.uniform(-0.5, 12.0, count)], axis=1
    )
    rows, uv = [], []
    poses = rig.world_SE3_cameras()
    for frame in range(len(rig.world_SE3_ego)):
        for number, camera in enumerate(rig.cameras.values()):
            row = frame * len(rig.cameras) + number
            images = camera.project(poses[row : row + 1].inverse().transform(points)[0])
            for point in np.flatnonzero(images.valid):
                rows.append((frame, number, point))
                uv.append(images.uv_px[point])
    frame_of, camera_of, point_of = np.array(rows).T
    seen = np.bincount(point_of, minlength=count) >= 3
    keep = seen[point_of]
    _, renumbered = np.unique(point_of[keep], return_inverse=True)
    return Tracks(
        points[seen], frame_of[keep], camera_of[keep], renumbered, np.array(uv)[keep], np.full(keep.sum(), 1.0)
    )


def perturb_intrinsics(rig: Rig, seed: int) -> Rig:
    """A recorded rig with errors of the standard deviations in `SPREAD`."""
    rng = np.random.default_rng(seed)

    def twisted(poses: Poses, turn: float, shift: float) -> Poses:
        return poses @ Poses.exp(rng.normal(size=(len(poses), 6)) * np.repeat([turn, shift], 3))

    return Rig(
        {name: replace(camera, cx_px=camera.cx_px + rng.normal(0.0, 0.2)) for name, camera in rig.cameras.items()},
        twisted(rig.ego_SE3_camera, SPREAD.mounting_rad, SPREAD.mounting_m),
        twisted(rig.world_SE3_ego, SPREAD.attitude_rad, SPREAD.position_m),
    )


def test_exact_tracks_recover_the_rig() -> None:
    rig = true_rig(CAMERAS)
    tracks = tracks_of(rig)
    recorded = perturb_intrinsics(rig, 1)
    start = replace(tracks, points=tracks.points + np.random.default_rng(2).normal(0.0, 0.05, tracks.points.shape))
    # The feature errors are negligible, so the tracks decide; the scale comes from the recorded poses.
    result, residual = adjust_rig(recorded, start, replace(SPREAD, feature_px=1e-3))
    before, after = pose_errors(recorded, rig), pose_errors(result, rig)
    assert before[0].max() > 0.05
    assert after[0].max() < 2e-3
    assert after[1].max() < 2.0
    assert after[1].max() < before[1].max()
    assert np.median(residual) < 1e-2


def test_a_fitting_rig_is_unchanged() -> None:
    rig = true_rig(CAMERAS)
    result, residual = adjust_rig(rig, tracks_of(rig), SPREAD)
    angle, distance = pose_errors(result, rig)
    assert angle.max() < 1e-6
    assert distance.max() < 1e-6
    assert residual.max() < 1e-6


def test_tracks_without_valid_points_are_refused() -> None:
    rig = true_rig(CAMERAS)
    tracks = tracks_of(rig)
    with pytest.raises(UsageError, match="points"):
        adjust_rig(rig, replace(tracks, points=tracks.points + np.nan), SPREAD)
    with pytest.raises(UsageError, match="0 points"):
        adjust_rig(rig, Tracks(*(values[:0] for values in vars(tracks).values())), SPREAD)


def test_wrong_matches_have_little_influence() -> None:
    rig = true_rig(CAMERAS)
    tracks = tracks_of(rig)
    rng = np.random.default_rng(6)
    wrong = rng.random(len(tracks.uv_px)) < 0.05
    noise = rng.normal(0.0, 0.15, tracks.uv_px.shape) + wrong[:, None] * rng.normal(0.0, 30.0, tracks.uv_px.shape)
    result, _ = adjust_rig(perturb_intrinsics(rig, 3), replace(tracks, uv_px=tracks.uv_px + noise), SPREAD)
    angle, distance = pose_errors(result, rig)
    assert angle.max() < 0.05
    assert distance.max() < 4.0


def test_only_a_rigid_alignment_is_removed() -> None:
    rig = true_rig(CAMERAS)
    moved = Poses.exp([[0.02, -0.01, 0.5, 3.0, -2.0, 1.0]])
    angle, distance = pose_errors(replace(rig, world_SE3_ego=moved @ rig.world_SE3_ego), rig)
    assert angle.max() < 1e-6
    assert distance.max() < 1e-9
    longer = Poses(rig.world_SE3_ego.rotation, 1.01 * rig.world_SE3_ego.translation)
    assert pose_errors(replace(rig, world_SE3_ego=longer), rig)[1].max() > 2.0


def test_pycolmap_triangulates_the_true_points() -> None:
    pytest.importorskip("pycolmap", reason="pycolmap is absent: pip install '.[calibration]'")
    rig = true_rig(COLMAPS, frames=4)
    exact = tracks_of(rig, 120)
    names = list(rig.cameras)
    features: dict[Key, Features] = {}
    places: dict[Key, dict[int, int]] = {}
    for frame in range(4):
        for number, name in enumerate(names):
            these = np.flatnonzero((exact.frame == frame) & (exact.camera == number))
            places[frame, name] = {int(exact.point[row]): place for place, row in enumerate(these)}
            features[frame, name] = Features(exact.uv_px[these], np.ones(len(these)), np.zeros((len(these), 128)))
    matches: dict[tuple[Key, Key], Int64] = {}
    keys = list(features)
    for at, one in enumerate(keys):
        for other in keys[at + 1 :]:
            common = sorted(places[one].keys() & places[other].keys())
            if common:
                matches[one, other] = np.array([(places[one][p], places[other][p]) for p in common])
    result = triangulate_tracks(rig, features, matches)
    assert len(result.points) > 60
    apart = np.linalg.norm(result.points[:, None] - exact.points[None], axis=2).min(axis=1)
    assert apart.max() < 1e-2
