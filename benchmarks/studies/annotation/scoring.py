"""Average precision of boxes of cars and vans on recorded synthetic drives, whose visible pixels are known."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow.parquet

from hybridworldsim.petr.tiny.samples import CameraInput, camera_input
from hybridworldsim.petr.tiny.settings import NetworkSettings
from mirror.arrays import Float64
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.geometry.quaternions import matrix_from_quaternion
from mirror.metrics.detection.boxes import DetectionBoxes
from mirror.metrics.detection.config import DetectionConfig
from mirror.metrics.detection.nuscenes import nuscenes_detection

CLASS: Final = "car"
MERGED: Final = frozenset({"car", "van"})


@dataclass(frozen=True)
class Bar:
    """The boxes that count: their range, their visible pixels, and the distances of a match.

    Attributes:
        range_m: greatest distance of true and found boxes from the vehicle.
        visible_px: least number of visible pixels of a true box in one image, of the network's raster.
        thresholds_m: distances of matches.
    """

    range_m: float
    visible_px: int
    thresholds_m: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Found:
    """K boxes of one frame, in its ego frame."""

    centre_m: Float64
    size_m: Float64
    yaw_rad: Float64
    score: Float64


@dataclass(frozen=True, eq=False)
class TestFrame:
    """A frame and its true boxes that count."""

    name: str
    cameras: CameraInput
    truth: Found
    bounds_px: Float64
    image: tuple[int, ...]


@dataclass(frozen=True)
class Scores:
    """Average precision by threshold, their mean, and the errors of true positives at 2 m."""

    ap: dict[str, float]
    mean_ap: float
    translation_m: float
    heading_rad: float
    frames: int
    boxes: int


def read_test_frames(dataset: Dataset, recordings: Path, bar: Bar, settings: NetworkSettings) -> list[TestFrame]:
    """Read frames, and the true boxes that show enough pixels."""
    tables: dict[str, dict[tuple[str, int], dict[str, tuple[int, Float64]]]] = {}
    frames = []
    for frame in dataset.frames():
        drive = frame.traversal_id.split(".")[1]
        if drive not in tables:
            tables[drive] = _read_truth(recordings / drive / "truth" / "boxes.parquet")
        frames.append(_test_frame(frame, tables[drive], bar, settings))
    return frames


def _read_truth(path: Path) -> dict[tuple[str, int], dict[str, tuple[int, Float64]]]:
    seen: dict[tuple[str, int], dict[str, tuple[int, Float64]]] = defaultdict(dict)
    for row in pyarrow.parquet.read_table(path).to_pylist():
        bounds = np.array([row[name] for name in ("u_min_px", "v_min_px", "u_max_px", "v_max_px")], np.float64)
        seen[row["camera"], row["timestamp_ns"]][row["track_id"]] = row["pixels"], bounds
    return seen


def _test_frame(
    frame: Frame, truth: dict[tuple[str, int], dict[str, tuple[int, Float64]]], bar: Bar, settings: NetworkSettings
) -> TestFrame:
    best: dict[str, tuple[float, int, Float64]] = {}
    for place, (camera, image) in enumerate(frame.images.items()):
        across, down = settings.width_px / image.width_px, settings.height_px / image.height_px
        for track, (pixels, bounds) in truth.get((camera, image.timestamp_ns), {}).items():
            scaled = pixels * across * down
            if scaled > best.get(track, (0.0, 0, bounds))[0]:
                best[track] = scaled, place, bounds * (across, down, across, down)
    boxes = frame.boxes("ego")
    rows = [
        row
        for row, (category, track) in enumerate(zip(boxes.category, boxes.track_id))
        if category in MERGED
        and best.get(track, (0.0,))[0] >= bar.visible_px
        and np.hypot(*boxes.pose.translation[row, :2]) <= bar.range_m
    ]
    pose = boxes.pose[np.array(rows, np.int64)]
    forward = matrix_from_quaternion(pose.rotation)[..., 0]
    seen = [best[boxes.track_id[row]] for row in rows]
    return TestFrame(
        f"{frame.traversal_id}.{frame.timestamp_ns}",
        camera_input(frame, settings),
        Found(pose.translation, boxes.size_m[rows], np.arctan2(forward[:, 1], forward[:, 0]), np.zeros(len(rows))),
        np.array([one[2] for one in seen]).reshape(-1, 4),
        tuple(one[1] for one in seen),
    )


def score(frames: Sequence[TestFrame], find: Callable[[TestFrame], Found], bar: Bar) -> Scores:
    """Score the boxes that `find` finds in each frame."""
    found = []
    for frame in frames:
        boxes = find(frame)
        near = np.hypot(*boxes.centre_m[:, :2].T) <= bar.range_m
        found.append(Found(boxes.centre_m[near], boxes.size_m[near], boxes.yaw_rad[near], boxes.score[near]))
    config = DetectionConfig({CLASS: bar.range_m}, bar.thresholds_m, 2.0, 0.1, 0.1, 500, 5)
    truth = _boxes([frame.truth for frame in frames])
    result = nuscenes_detection(truth, _boxes(found), config)
    aps = {f"{distance:g}": float(ap) for distance, ap in zip(bar.thresholds_m, result.label_aps[0])}
    translation, _, heading = result.label_tp_errors[0][:3].tolist()
    return Scores(aps, float(result.mean_ap), translation, heading, len(frames), len(truth))


@dataclass(frozen=True)
class OperatingPoint:
    """Precision and recall above a score: the shares of found boxes and of true boxes that match."""

    score: float
    precision: float
    recall: float


def operating_points(
    frames: Sequence[TestFrame], find: Callable[[TestFrame], Found], bar: Bar, scores: Sequence[float]
) -> list[OperatingPoint]:
    """Return the precision and recall above each of some scores.

    The best box comes first, matches are within the largest threshold.
    """
    rows: list[tuple[float, bool]] = []
    count = 0
    for frame in frames:
        boxes, free = find(frame), np.ones(len(frame.truth.score), np.bool_)
        count += len(free)
        for one in np.argsort(-boxes.score, kind="stable"):
            if np.hypot(*boxes.centre_m[one, :2]) > bar.range_m:
                continue
            away = np.linalg.norm(frame.truth.centre_m[:, :2] - boxes.centre_m[one, :2], axis=1)
            away[~free] = np.inf
            matched = bool(len(away)) and away.min() < max(bar.thresholds_m)
            if matched:
                free[away.argmin()] = False
            rows.append((float(boxes.score[one]), matched))
    values = np.array(rows).reshape(-1, 2)
    points = []
    for least in scores:
        right = values[values[:, 0] >= least, 1]
        points.append(OperatingPoint(least, float(right.mean()) if len(right) else 1.0, float(right.sum()) / count))
    return points


def _boxes(frames: Sequence[Found]) -> DetectionBoxes:
    count = sum(len(one.score) for one in frames)
    return DetectionBoxes(
        np.repeat(np.arange(len(frames)), [len(one.score) for one in frames]),
        np.full(count, CLASS),
        np.concatenate([one.centre_m for one in frames]),
        np.concatenate([one.size_m for one in frames]),
        np.concatenate([one.yaw_rad for one in frames]),
        np.full((count, 2), np.nan),
        np.full(count, ""),
        np.concatenate([one.score for one in frames]),
    )
