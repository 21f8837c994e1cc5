"""Exact road users of synthetic drives, and detections of them with stated noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mirror.annotation.detections import Detections
from mirror.annotation.tracking.options import group_of
from mirror.arrays import Bool, Float64, Int64
from mirror.geometry.poses import Poses
from mirror.metrics.tracking import TrackedBoxes
from mirror.synth.fleet.drives import make_drives

RANGE_M = 50.0
_START_S = 0.5


@dataclass(frozen=True, eq=False)
class TrueDrive:
    """The road users of a drive at equal steps of time.

    Attributes:
        name: id of the drive.
        timestamp_ns: (F,) times.
        world_SE3_ego: F poses.
        position_m: (U, F, 3) of each road user, middle of the box.
        yaw_rad: (U, F).
        velocity_mps: (U, F, 2).
        near: (U, F) within `RANGE_M` of the vehicle.
        size_m: (U, 3).
        category: U names.
    """

    name: str
    timestamp_ns: Int64
    world_SE3_ego: Poses
    position_m: Float64
    yaw_rad: Float64
    velocity_mps: Float64
    near: Bool
    size_m: Float64
    category: tuple[str, ...]

    def truth(self) -> list[TrackedBoxes]:
        """Return the true boxes of each frame."""
        frames = []
        for frame in range(len(self.timestamp_ns)):
            rows = np.flatnonzero(self.near[:, frame])
            frames.append(
                TrackedBoxes(rows, self.position_m[rows, frame, :2], self.velocity_mps[rows, frame], np.ones(len(rows)))
            )
        return frames


@dataclass(frozen=True)
class Noise:
    """The errors that a detector adds to the truth.

    Attributes:
        sigma_m: standard deviation of each horizontal coordinate at range 0.
        sigma_share: its growth with the range.
        missed: share of the boxes that are missed.
        burst_s: mean length of a run of misses.
        false_boxes: mean number of false boxes per frame, uniform in the disc of `RANGE_M`.
    """

    sigma_m: float = 0.25
    sigma_share: float = 0.02
    missed: float = 0.3
    burst_s: float = 0.5
    false_boxes: float = 1.0


def true_drives(hz: float, *, seed: int, drives: int, duration_s: float) -> list[TrueDrive]:
    """Return the drives of the preset ``demo``, which is in an urban scene and on a campus."""
    _, all_drives = make_drives("demo", seed)
    result = []
    for drive in [one for one in all_drives if one.recipe.images][:drives]:
        last_s = min(drive.truth.duration_s - _START_S, _START_S + duration_s)
        time_s = np.arange(_START_S, last_s, 1.0 / hz)
        stamps = drive.condition.start_ns + np.round(time_s * 1e9).astype(np.int64)
        ego = drive.world_SE3_ego(stamps)
        positions, yaws, velocities, sizes, names = [], [], [], [], []
        for user in drive.road_users:
            placed, speed = drive.placements(user, stamps)
            if np.linalg.norm(placed[:, :2] - ego.translation[:, :2], axis=1).min() > RANGE_M:
                continue
            yaw = placed[:, 3]
            positions.append(placed[:, :3] + (0.0, 0.0, 0.5 * user.body.size_m[2]))
            yaws.append(yaw)
            velocities.append(speed[:, None] * np.stack((np.cos(yaw), np.sin(yaw)), axis=1))
            sizes.append(user.body.size_m)
            names.append(user.body.category)
        position = np.array(positions)
        near = np.linalg.norm(position[..., :2] - ego.translation[None, :, :2], axis=-1) <= RANGE_M
        result.append(
            TrueDrive(
                drive.drive_id, stamps, ego, position, np.array(yaws), np.array(velocities), near, np.array(sizes),
                tuple(names),
            )
        )  # fmt: skip
    return result


def detect(drive: TrueDrive, noise: Noise, seed: int) -> list[Detections]:
    """Return the detections of each frame."""
    rng = np.random.default_rng(seed)
    users, count = drive.near.shape
    step_s = float(np.median(np.diff(drive.timestamp_ns))) * 1e-9
    ends = min(step_s / noise.burst_s, 1.0)
    begins = ends * noise.missed / (1.0 - noise.missed)
    missed = np.zeros((users, count), np.bool_)
    state: Any = rng.random(users) < noise.missed
    for frame in range(count):
        missed[:, frame] = state
        draw = rng.random(users)
        state = np.where(state, draw >= ends, draw < begins)
    frames = []
    for frame in range(count):
        rows = np.flatnonzero(drive.near[:, frame] & ~missed[:, frame])
        ego = drive.world_SE3_ego[frame : frame + 1]
        centre = drive.position_m[rows, frame].copy()
        away = np.linalg.norm(centre[:, :2] - ego.translation[0, :2], axis=1)
        centre[:, :2] += rng.normal(size=(len(rows), 2)) * (noise.sigma_m + noise.sigma_share * away)[:, None]
        yaw = drive.yaw_rad[rows, frame] + rng.normal(0.0, 0.1, len(rows)) + np.pi * (rng.random(len(rows)) < 0.03)
        size = drive.size_m[rows] * np.exp(rng.normal(0.0, 0.05, (len(rows), 3)))
        score = rng.beta(6.0, 3.0, len(rows))
        category = [drive.category[row] for row in rows]
        extra = int(rng.poisson(noise.false_boxes))
        if extra:
            radius, angle = RANGE_M * np.sqrt(rng.random(extra)), rng.uniform(0.0, 2.0 * np.pi, extra)
            around = np.stack((radius * np.cos(angle), radius * np.sin(angle), np.zeros(extra)), axis=1)
            centre = np.concatenate((centre, ego.translation + around))
            yaw = np.concatenate((yaw, rng.uniform(-np.pi, np.pi, extra)))
            size = np.concatenate((size, np.tile((4.5, 1.9, 1.6), (extra, 1))))
            score = np.concatenate((score, rng.beta(3.0, 6.0, extra)))
            category += rng.choice(["car", "van", "pedestrian"], extra, p=[0.6, 0.1, 0.3]).tolist()
        half = 0.5 * yaw
        zero = np.zeros(len(yaw))
        pose = Poses(np.stack((np.cos(half), zero, zero, np.sin(half)), axis=1), centre)
        frames.append(
            Detections(
                int(drive.timestamp_ns[frame]),
                ego.inverse() @ pose,
                size,
                np.full((len(yaw), 3), np.nan),
                tuple(category),
                score,
            )
        )
    return frames


def greedy(detections: list[Detections], world_SE3_ego: Poses, *, gate_m: float, age: int) -> list[TrackedBoxes]:
    """Match boxes to the last position of tracks, nearest first: the usual simple tracker.

    Args:
        detections: boxes of each frame.
        world_SE3_ego: one pose a frame.
        gate_m: greatest distance of a match.
        age: a track ends after as many frames without a box.
    """
    place: list[Float64] = []
    last: list[int] = []
    times: list[int] = []
    group: list[str] = []
    frames = []
    for number, found in enumerate(detections):
        pose = world_SE3_ego[number : number + 1] @ found.ego_SE3_box if len(found) else found.ego_SE3_box
        xy = pose.translation[:, :2]
        names = [group_of(name) for name in found.category]
        ids = np.full(len(found), -1, np.int64)
        velocity = np.full((len(found), 2), np.nan)
        living = [one for one in range(len(place)) if number - last[one] <= age]
        pairs = sorted(
            (float(np.linalg.norm(xy[box] - place[one])), box, one)
            for box in range(len(found))
            for one in living
            if group[one] == names[box]
        )
        taken: set[int] = set()
        for away, box, one in pairs:
            if away > gate_m:
                break
            if ids[box] < 0 and one not in taken:
                seconds = (found.timestamp_ns - times[one]) * 1e-9
                ids[box], velocity[box] = one, (xy[box] - place[one]) / seconds
                taken.add(one)
        for box in range(len(found)):
            if ids[box] < 0:
                ids[box] = len(place)
                place.append(xy[box])
                last.append(number)
                times.append(found.timestamp_ns)
                group.append(names[box])
            one = int(ids[box])
            place[one], last[one], times[one] = xy[box], number, found.timestamp_ns
        frames.append(TrackedBoxes(ids, xy.copy(), velocity, found.score))
    return frames


def tracked(tracks: list[Detections], world_SE3_ego: Poses) -> list[TrackedBoxes]:
    """Return the boxes of `mirror.annotation.track` for `score_tracks`."""
    frames = []
    for number, found in enumerate(tracks):
        if not len(found):
            frames.append(TrackedBoxes(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2)), np.empty(0)))
            continue
        ego = world_SE3_ego[number : number + 1]
        turn = Poses(ego.rotation, np.zeros((1, 3)))
        frames.append(
            TrackedBoxes(
                np.array([int(name) for name in found.track_id]),
                (ego @ found.ego_SE3_box).translation[:, :2],
                turn.transform(found.velocity_mps).reshape(-1, 3)[:, :2],
                found.score,
            )
        )
    return frames
