"""Tracks of noisy boxes against the motions that they were drawn from."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.annotation.detections import Detections
from mirror.annotation.tracking.options import BoxTrackingOptions, group_of
from mirror.annotation.tracking.smoothing import smooth_turning, smooth_velocity
from mirror.annotation.tracking.static import merge_stationary
from mirror.annotation.tracking.tracker import find_tracks, track
from mirror.errors import UsageError
from mirror.geometry.poses import Poses
from mirror.metrics.tracking import TrackedBoxes, score_tracks

SECOND = 1_000_000_000


def yaw_rotation(yaw: np.ndarray) -> np.ndarray:
    zero = np.zeros(len(yaw))
    return np.stack((np.cos(yaw / 2), zero, zero, np.sin(yaw / 2)), axis=1)


def frame(stamp: int, world: np.ndarray, yaw: np.ndarray, ego: Poses, category: str = "car") -> Detections:
    """Detections at exact world positions (N, 3)."""
    if not len(world):
        return Detections.empty(stamp)
    count = len(world)
    return Detections(
        stamp, ego.inverse() @ Poses(yaw_rotation(yaw), world), np.tile((4.0, 1.8, 1.5), (count, 1)),
        np.full((count, 3), np.nan), (category,) * count, np.full(count, 0.9),
    )  # fmt: skip


def drive(count: int = 60, dt: float = 0.1) -> tuple[np.ndarray, Poses]:
    """Times and poses of a vehicle that drives a bend, at large world coordinates."""
    time = np.arange(count) * dt
    place = np.stack((5e5 + 8.0 * time, 4e6 + 0.2 * time**2, np.full(count, 200.0)), axis=1)
    return time, Poses(yaw_rotation(0.05 * time), place)


def test_crossing_cars_and_a_parked_one_keep_their_ids_through_gaps() -> None:
    time, ego = drive()
    rng = np.random.default_rng(0)
    base = ego.translation[30]
    one = base + np.stack((-24.0 + 8.0 * time, np.full(60, 3.0), np.zeros(60)), axis=1)
    other = base + np.stack((24.0 - 8.0 * time, np.full(60, -1.0), np.zeros(60)), axis=1)
    parked = base + np.tile((5.0, 9.0, 0.0), (60, 1))
    frames = []
    for row in range(60):
        world = np.stack((one[row], other[row], parked[row])) + rng.normal(size=(3, 3)) * (0.3, 0.3, 0.05)
        yaw = np.array([0.0, np.pi, 0.3 + np.pi * (row % 7 == 0)])
        # A burst of misses while the two cars pass each other.
        present = [0, 1, 2] if not 24 <= row < 36 else [2]
        frames.append(frame(row * SECOND // 10, world[present], yaw[present], ego[row]))
    tracks = find_tracks(frames, ego)
    assert len(tracks) == 3
    truths = {0: one, 1: other, 2: parked}
    for key, truth in truths.items():
        near = [item for item in tracks if np.linalg.norm(item.centre_m[0, :2] - truth[0, :2]) < 1.5]
        assert len(near) == 1
        item = near[0]
        assert item.frames.tolist() == list(range(60))
        assert np.linalg.norm(item.centre_m[:, :2] - truth[:, :2], axis=1).mean() < 0.2
        velocity = np.gradient(truth[:, :2], 0.1, axis=0)
        assert np.linalg.norm(item.velocity_mps - velocity, axis=1).mean() < 0.3
        assert item.stationary == (key == 2)
        # Half turns of the heading are corrected.
        expected = (0.0, np.pi, 0.3)[key]
        assert np.abs(np.sin(item.yaw_rad - expected)).max() < 0.1
        assert np.cos(item.yaw_rad - expected).min() > 0.9


def test_smoothing_is_the_least_squares_solution() -> None:
    """A smoother of Rauch, Tung and Striebel equals weighted least squares over the whole path."""
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.05, 0.6, 12))
    measured = rng.normal(size=(12, 2)) * 3.0
    measured[[3, 4, 8]] = np.nan
    sigma, density, speed = rng.uniform(0.2, 0.9, 12), 1.3, 6.0
    rows, values = [], []

    def add(block: np.ndarray, at: int, covariance: np.ndarray, value: np.ndarray) -> None:
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        whole = np.zeros((len(block), 24))
        whole[:, at : at + block.shape[1]] = block
        rows.append(root @ whole)
        values.append(root @ value)

    # One axis at a time: the state is (x, v); the first measurement is also the prior of the position.
    solutions = []
    for axis in (0, 1):
        rows, values = [], []
        add(np.eye(2), 0, np.diag([sigma[0] ** 2, speed**2]), np.array([measured[0, axis], 0.0]))
        for row in range(12):
            if row:
                dt = time[row] - time[row - 1]
                noise = density**2 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
                block = np.array([[-1.0, -dt, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]])
                add(block, 2 * (row - 1), noise, np.zeros(2))
            if np.isfinite(measured[row, 0]):
                add(np.array([[1.0, 0.0]]), 2 * row, np.array([[sigma[row] ** 2]]), measured[row, axis : axis + 1])
        matrix, right = np.concatenate(rows), np.concatenate(values)
        solutions.append(np.linalg.lstsq(matrix, right, rcond=None)[0].reshape(12, 2))
    path = smooth_velocity(time, measured, sigma, density, speed)
    np.testing.assert_allclose(path.position_m, np.stack([one[:, 0] for one in solutions], axis=1), atol=1e-9)
    np.testing.assert_allclose(path.velocity_mps, np.stack([one[:, 1] for one in solutions], axis=1), atol=1e-9)


def test_the_turn_model_follows_a_roundabout_at_2_hz() -> None:
    time = np.arange(0.0, 8.0, 0.5)
    angle = 0.6 * time
    truth = 10.0 * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    velocity = 6.0 * np.stack((-np.sin(angle), np.cos(angle)), axis=1)
    turning, straight = [], []
    for seed in range(8):
        measured = truth + np.random.default_rng(seed).normal(0.0, 0.4, truth.shape)
        start = smooth_velocity(time, measured, np.full(16, 0.4), 1.2, 8.0)
        path = smooth_turning(time, measured, np.full(16, 0.4), 1.2, start)
        turning.append(np.linalg.norm(path.velocity_mps - velocity, axis=1).mean())
        straight.append(np.linalg.norm(start.velocity_mps - velocity, axis=1).mean())
    assert np.mean(turning) < 0.8 * np.mean(straight)


def test_stationary_objects_of_two_traversals_share_a_place() -> None:
    rng = np.random.default_rng(2)
    tracks = {}
    place = np.array([[10.0, 4.0, 1.0], [16.0, 4.0, 1.0]])
    for name in ("a", "b"):
        ego = Poses.identity(30)
        frames = [
            frame(row * SECOND // 5, place + rng.normal(size=(2, 3)) * (0.3, 0.3, 0.0), np.zeros(2), ego[row])
            for row in range(30)
        ]
        tracks[name] = find_tracks(frames, ego)
    merged = merge_stationary(tracks)
    for one, other in zip(*(sorted(merged[name], key=lambda item: item.centre_m[0, 0]) for name in ("a", "b"))):
        np.testing.assert_array_equal(one.centre_m[0, :2], other.centre_m[0, :2])
    # Neighbours stay apart.
    assert len({tuple(item.centre_m[0, :2]) for item in merged["a"]}) == 2


def test_one_frame_no_boxes_and_wrong_input() -> None:
    ego = Poses.identity(1)
    single = frame(0, np.array([[3.0, 0.0, 0.0]]), np.zeros(1), ego)
    assert [len(found) for found in track([single], ego)] == [0]
    assert [len(found) for found in track([single], ego, BoxTrackingOptions(min_boxes=1))] == [1]
    assert track([], Poses.identity(0)) == []
    assert [len(found) for found in track([Detections.empty(0), Detections.empty(1)], Poses.identity(2))] == [0, 0]
    with pytest.raises(UsageError, match="1 frames with 2 poses"):
        track([single], Poses.identity(2))
    with pytest.raises(UsageError, match="time 0 after 0"):
        track([single, single], Poses.identity(2))
    with pytest.raises(UsageError, match="--gate-m: nan"):
        BoxTrackingOptions(gate_m=float("nan"))
    assert (group_of("Bus"), group_of("pedestrian"), group_of("motorcycle")) == ("vehicle", "pedestrian", "two_wheeler")


def boxes(*rows: tuple[int, float, float]) -> TrackedBoxes:
    """Boxes at (id, x, score)."""
    given = np.array(rows).reshape(-1, 3)
    place = np.stack((given[:, 1], np.zeros(len(given))), axis=1)
    return TrackedBoxes(given[:, 0].astype(np.int64), place, np.zeros((len(given), 2)), given[:, 2])


def test_scores_of_tracks_worked_by_hand() -> None:
    truth = [[boxes((0, 0.0, 1.0), (1, 10.0, 1.0)) for _ in range(4)]]
    # Track 5 follows object 0 for two frames, then track 6; object 1 is missed once; one false box.
    found = [
        [
            boxes((5, 0.5, 0.9), (7, 10.0, 0.8)),
            boxes((5, 0.5, 0.9), (7, 10.0, 0.8), (9, 40.0, 0.7)),
            boxes((6, 0.5, 0.9), (7, 10.0, 0.8)),
            boxes((6, 0.5, 0.9)),
        ]
    ]
    scores = score_tracks(truth, found)
    # At the score 0.8: 7 of 8 matched, one switch, no false box.
    assert (scores.switches, scores.false_per_frame, scores.misses) == (1, 0.0, 1 / 8)
    assert scores.mota == pytest.approx(1.0 - 2 / 8)
    # Best assignment: 0 with 5 (2 boxes), 1 with 7 (3 boxes); 8 true boxes, 8 found.
    assert scores.idf1 == pytest.approx(2 * 5 / 16)
    assert scores.position_error_m == pytest.approx(4 * 0.5 / 7)
    perfect = score_tracks(truth, [[boxes((0, 0.0, 1.0), (1, 10.0, 1.0)) for _ in range(4)]])
    assert (perfect.mota, perfect.idf1, perfect.switches) == (1.0, 1.0, 0)
    assert perfect.amota == pytest.approx(1.0)
    nothing = score_tracks(truth, [[boxes() for _ in range(4)]])
    assert (nothing.mota, nothing.amota, nothing.idf1) == (0.0, 0.0, 0.0)
