"""Tracks the boxes of one traversal, with all of its frames at hand: an offline tracker."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from mirror.annotation.detections import Detections
from mirror.annotation.tracking.association import Tracklet, WorldBoxes, associate
from mirror.annotation.tracking.options import ACCELERATION_MPS2, BoxTrackingOptions, group_of
from mirror.annotation.tracking.smoothing import SmoothedPath, smooth_turning, smooth_velocity
from mirror.arrays import Bool, Float64, Int64
from mirror.errors import UsageError
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import matrix_from_quaternion, rotate

_SPEED_MPS: Final = {"vehicle": 8.0, "two_wheeler": 5.0, "pedestrian": 1.5, "static": 0.1}
_STATIONARY_RMS: Final = 1.35
_STATIONARY_DRIFT: Final = 3.0
_HEADING_MPS: Final = 1.0
_NOT_SURE: Final = 3.0
_HEIGHT_S: Final = 0.5


@dataclass(frozen=True, eq=False)
class ObjectTrack:
    """One object, at the F frames in which it exists.

    Attributes:
        track_id: its id in the traversal.
        category: the category of most of its boxes, weighted by score.
        score: see `track_score`.
        stationary: whether all its boxes agree with one position.
        frames: (F,) numbers of the frames.
        centre_m: (F, 3) in the world frame.
        yaw_rad: (F,) heading.
        velocity_mps: (F, 2) along world x and y.
        size_m: (3,) median length, width, height.
        measured: (F,) False where the position is interpolated over a gap.
        sigma_m: standard deviation of the position along one axis, mean over the frames.
    """

    track_id: str
    category: str
    score: float
    stationary: bool
    frames: Int64
    centre_m: Float64
    yaw_rad: Float64
    velocity_mps: Float64
    size_m: Float64
    measured: Bool
    sigma_m: float


def track(
    detections: Sequence[Detections], world_SE3_ego: Poses, options: BoxTrackingOptions | None = None
) -> list[Detections]:
    """Track the boxes of a traversal.

    Args:
        detections: boxes of each frame, in order of time.
        world_SE3_ego: one pose of the vehicle for each frame.
        options: see `BoxTrackingOptions`.

    Returns:
        The boxes of the tracks in each frame, with ids, smooth positions, velocities and one size each.

    Raises:
        UsageError: frames and poses do not fit, or times do not ascend.
    """
    return to_frames(find_tracks(detections, world_SE3_ego, options), detections, world_SE3_ego)


def find_tracks(
    detections: Sequence[Detections], world_SE3_ego: Poses, options: BoxTrackingOptions | None = None
) -> list[ObjectTrack]:
    """Return the tracks of a traversal in the world frame; see `track` for the arguments.

    Raises:
        UsageError: frames and poses do not fit, or times do not ascend.
    """
    options = options or BoxTrackingOptions()
    if len(detections) != len(world_SE3_ego):
        raise UsageError(
            f"{len(detections)} frames with {len(world_SE3_ego)} poses", expected="one pose for each frame"
        )
    stamps = np.array([frame.timestamp_ns for frame in detections], np.int64)
    if (np.diff(stamps) <= 0).any():
        row = int(np.argmax(np.diff(stamps) <= 0)) + 1
        raise UsageError(
            f"time {stamps[row]} after {stamps[row - 1]}", place=f"frame {row}", expected="ascending times"
        )
    if not len(stamps):
        return []
    time_s = (stamps - stamps[0]).astype(np.float64) * 1e-9
    frames = [_to_world(found, world_SE3_ego[row], float(time_s[row]), options) for row, found in enumerate(detections)]
    tracks: list[ObjectTrack] = []
    for tracklet in associate(frames, options):
        if len(tracklet.frames) >= options.min_boxes:
            score = track_score([float(frames[f].score[b]) for f, b in zip(tracklet.frames, tracklet.boxes)])
            if score >= options.min_score:
                tracks.append(_fit(f"{len(tracks):05d}", score, tracklet, frames, time_s, options))
    return tracks


def track_score(scores: Sequence[float]) -> float:
    """Return the score of a track of N boxes: their mean score times N / (N + 3).

    Short tracks are more often false.
    """
    return float(np.mean(scores)) * len(scores) / (len(scores) + _NOT_SURE)


def to_frames(
    tracks: Sequence[ObjectTrack], detections: Sequence[Detections], world_SE3_ego: Poses
) -> list[Detections]:
    """Return the boxes of tracks in each frame, in the ego frame at that frame's time."""
    rows: dict[int, list[tuple[ObjectTrack, int]]] = defaultdict(list)
    for item in tracks:
        for place, frame in enumerate(item.frames.tolist()):
            rows[frame].append((item, place))
    result = []
    for number, frame in enumerate(detections):
        present = rows[number]
        if not present:
            result.append(Detections.empty(frame.timestamp_ns))
            continue
        half = 0.5 * np.array([item.yaw_rad[place] for item, place in present])
        zero = np.zeros(len(present))
        rotation = np.stack((np.cos(half), zero, zero, np.sin(half)), axis=1)
        centre = np.array([item.centre_m[place] for item, place in present])
        ego_SE3_world = world_SE3_ego[number : number + 1].inverse()
        velocity = np.zeros((len(present), 3))
        velocity[:, :2] = [item.velocity_mps[place] for item, place in present]
        result.append(
            Detections(
                frame.timestamp_ns,
                ego_SE3_world @ Poses(rotation, centre),
                np.array([item.size_m for item, _ in present]),
                rotate(ego_SE3_world.rotation, velocity),
                tuple(item.category for item, _ in present),
                np.array([item.score for item, _ in present]),
                tuple(item.track_id for item, _ in present),
            )
        )
    return result


def _to_world(found: Detections, world_SE3_ego: Poses, time_s: float, options: BoxTrackingOptions) -> WorldBoxes:
    pose = world_SE3_ego @ found.ego_SE3_box if len(found) else found.ego_SE3_box
    forward = matrix_from_quaternion(pose.rotation)[..., 0] if len(found) else np.empty((0, 3))
    away = np.linalg.norm(found.ego_SE3_box.translation[:, :2], axis=1)
    return WorldBoxes(
        time_s,
        pose.translation,
        np.arctan2(forward[:, 1], forward[:, 0]),
        found.size_m,
        options.sigma_m + options.sigma_share * away,
        np.where(np.isnan(found.score), 1.0, found.score),
        found.category,
        tuple(group_of(name) for name in found.category),
    )


def _fit(
    track_id: str,
    score: float,
    tracklet: Tracklet,
    frames: Sequence[WorldBoxes],
    time_s: Float64,
    options: BoxTrackingOptions,
) -> ObjectTrack:
    """Fit the path of one object, and choose the frames in which it has a box."""
    own = np.array(tracklet.frames)
    boxes = list(zip(tracklet.frames, tracklet.boxes))
    centre = np.array([frames[f].centre_m[b] for f, b in boxes])
    yaw = np.array([frames[f].yaw_rad[b] for f, b in boxes])
    sigma = np.array([frames[f].sigma_m[b] for f, b in boxes])
    weight = np.array([frames[f].score[b] for f, b in boxes])
    every = np.arange(own[0], own[-1] + 1)
    at = own - own[0]
    measured = np.full((len(every), 2), np.nan)
    measured[at] = centre[:, :2]
    spread = np.full(len(every), sigma.max())
    spread[at] = sigma
    stationary = _is_stationary(time_s[own], centre[:, :2], sigma)
    if stationary or tracklet.group == "static":
        share = sigma**-2 / (sigma**-2).sum()
        path = SmoothedPath(
            np.tile(share @ centre[:, :2], (len(every), 1)),
            np.zeros((len(every), 2)),
            np.full(len(every), (sigma**-2).sum() ** -0.5),
        )
    else:
        acceleration = ACCELERATION_MPS2[tracklet.group]
        path = smooth_velocity(time_s[every], measured, spread, acceleration, _SPEED_MPS[tracklet.group])
        speed = np.linalg.norm(path.velocity_mps, axis=1)
        if options.turn_model and tracklet.group in ("vehicle", "two_wheeler") and speed.max() > 2.0 and len(own) > 3:
            path = smooth_turning(time_s[every], measured, spread, acceleration, path)
    heading = _heading(path, yaw, at)
    height = _smooth_height(time_s[own], centre[:, 2], time_s[every], sigma)
    keep = _kept_frames(at, time_s[every], options.fill_gaps_s)
    names: dict[str, float] = defaultdict(float)
    for f, b in boxes:
        names[frames[f].category[b]] += float(frames[f].score[b]) + 1e-9
    is_measured = np.zeros(len(every), np.bool_)
    is_measured[at] = True
    return ObjectTrack(
        track_id=track_id,
        category=max(names, key=lambda name: names[name]),
        score=score,
        stationary=stationary,
        frames=every[keep],
        centre_m=np.column_stack((path.position_m, height))[keep],
        yaw_rad=heading[keep],
        velocity_mps=path.velocity_mps[keep],
        size_m=_weighted_median(np.array([frames[f].size_m[b] for f, b in boxes]), weight),
        measured=is_measured[keep],
        sigma_m=float(path.sigma_m.mean()),
    )


def _is_stationary(time_s: Float64, position: Float64, sigma: Float64) -> bool:
    """Return whether positions agree with one place: by their scatter, and by the slope of a line through them."""
    weight = sigma**-2
    mean = weight @ position / weight.sum()
    residual = (position - mean) / sigma[:, None]
    scatter = np.sqrt(np.mean(residual**2))
    offset = time_s - weight @ time_s / weight.sum()
    inertia = float(weight @ offset**2)
    if inertia <= 0.0:
        return True
    slope = (weight * offset) @ (position - mean) / inertia
    drift = float(np.linalg.norm(slope)) * np.sqrt(inertia)
    return bool(scatter < _STATIONARY_RMS and drift < _STATIONARY_DRIFT)


def _heading(path: SmoothedPath, yaw: Float64, at: Int64) -> Float64:
    """Heading (F,): that of the motion where it is fast enough, else the boxes' own, corrected for half turns."""
    speed = np.linalg.norm(path.velocity_mps, axis=1)
    moving = speed > _HEADING_MPS
    course = np.arctan2(path.velocity_mps[:, 1], path.velocity_mps[:, 0])
    # The axis is the mean of doubled angles; its direction is that of most boxes.
    axis = 0.5 * np.arctan2(np.sin(2.0 * yaw).mean(), np.cos(2.0 * yaw).mean())
    resting = axis if np.cos(yaw - axis).sum() >= 0.0 else axis + np.pi
    if not moving.any():
        return np.full(len(path.position_m), resting)
    # Without motion the object keeps the course that it last had, or will first have.
    rows = np.flatnonzero(moving)
    places = np.arange(len(speed))
    before = rows[np.clip(np.searchsorted(rows, places, side="right") - 1, 0, len(rows) - 1)]
    after = rows[np.clip(np.searchsorted(rows, places), 0, len(rows) - 1)]
    nearest = np.where(np.abs(before - places) <= np.abs(after - places), before, after)
    return course[nearest]


def _smooth_height(time_s: Float64, height: Float64, wanted_s: Float64, sigma: Float64) -> Float64:
    """Heights (F,) as weighted means over about a second."""
    away = (wanted_s[:, None] - time_s[None]) / _HEIGHT_S
    # The nearest box always counts, so that no sum of weights vanishes.
    away -= np.sign(away) * np.abs(away).min(axis=1, keepdims=True)
    weight = np.exp(-0.5 * away**2) * sigma**-2
    return np.asarray(weight @ height / weight.sum(axis=1))


def _kept_frames(at: Int64, time_s: Float64, fill_gaps_s: float) -> Bool:
    """The frames (F,) with a box: the measured ones, and those in gaps that are short enough."""
    keep = np.zeros(len(time_s), np.bool_)
    keep[at] = True
    for before, after in pairwise(at.tolist()):
        if time_s[after] - time_s[before] <= fill_gaps_s:
            keep[before:after] = True
    return keep


def _weighted_median(values: Float64, weight: Float64) -> Float64:
    """Median (3,) of each column of values (N, 3)."""
    weight = np.maximum(weight, 1e-9)
    result = []
    for column in values.T:
        order = np.argsort(column)
        passed = np.cumsum(weight[order])
        result.append(column[order][int(np.searchsorted(passed, 0.5 * passed[-1]))])
    return np.array(result)
