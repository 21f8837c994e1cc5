"""The results format of the nuScenes detection task: read and written.

``{"meta": {...}, "results": {sample_token: [box, ...]}}`` with ``translation`` (centre), ``size`` (width, length,
height), ``rotation`` (quaternion, scalar first) and ``velocity`` in the world frame of the scene, ``detection_name``
and ``detection_score``. Source: https://www.nuscenes.org/object-detection. The sample token of a frame is
``<traversal_id>.<timestamp_ns>``. A score below 0, or none, marks a label that a person made. Our files also carry
``tracking_id`` and, under ``meta``, the hash of the recorded data.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.annotation.detections import AnnotationError, Detections
from mirror.dataset.frames import Frame
from mirror.errors import UsageError
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import rotate
from mirror.schema.files import write_bytes
from mirror.schema.strict_json import decode_json

_EXPECTED: Final = '{"meta": {...}, "results": {"<traversal_id>.<timestamp_ns>": [box, ...]}}'
_META: Final = {
    "use_camera": True, "use_lidar": False, "use_radar": False, "use_map": False, "use_external": False,
}  # fmt: skip


def sample_token(traversal_id: str, timestamp_ns: int) -> str:
    """Return the token of a frame."""
    return f"{traversal_id}.{timestamp_ns}"


def read_results(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Read the boxes of a results file by sample token; `to_detections` checks the boxes of a sample.

    Raises:
        UsageError: the file is missing, is not JSON, or has another structure.
    """
    try:
        document = decode_json(path.read_bytes())
    except OSError as error:
        raise UsageError(f"cannot be read: {error.strerror}", file=path, expected="a file of results") from error
    except ValueError as error:
        raise UsageError(f"not JSON: {error}", file=path, expected=_EXPECTED) from error
    results = document.get("results") if isinstance(document, dict) else None
    if not isinstance(results, dict):
        raise UsageError("no object `results`", file=path, expected=_EXPECTED)
    for token, boxes in results.items():
        if not isinstance(boxes, list) or not all(isinstance(box, dict) for box in boxes):
            raise UsageError("not a list of boxes", file=path, place=f"results.{token}", expected=_EXPECTED)
    return results


def to_detections(boxes: Sequence[Mapping[str, Any]], timestamp_ns: int, world_SE3_ego: Poses) -> Detections:
    """Convert the boxes of one sample from the world frame to the ego frame.

    Args:
        boxes: boxes of the sample, as in the file.
        timestamp_ns: time of the boxes.
        world_SE3_ego: one pose of the vehicle at that time.

    Raises:
        AnnotationError: a box lacks a value, or has an invalid one; its number and the value are named.
    """
    centre = _numbers(boxes, "translation", 3)
    size = _numbers(boxes, "size", 3)[:, [1, 0, 2]]
    rotation = _numbers(boxes, "rotation", 4)
    velocity = np.full((len(boxes), 3), np.nan)
    velocity[:, :2] = _numbers(boxes, "velocity", 2, default=np.nan)
    score = _numbers(boxes, "detection_score", 1, default=np.nan)[:, 0]
    score[score < 0.0] = np.nan
    names = [str(box.get("detection_name") or "") for box in boxes]
    tracks = [str(box["tracking_id"]) for box in boxes if box.get("tracking_id") is not None]
    known = np.isfinite(velocity[:, :2]).all(axis=1)
    velocity[known, 2] = 0.0
    in_world = Detections.from_arrays(timestamp_ns, centre, rotation, size, velocity, names, score)
    if not len(boxes):
        return in_world
    ego_SE3_world = world_SE3_ego.inverse()
    turned = np.full_like(velocity, np.nan)
    turned[known] = rotate(ego_SE3_world.rotation, velocity[known])
    return Detections(
        timestamp_ns,
        ego_SE3_world @ in_world.ego_SE3_box,
        size,
        turned,
        in_world.category,
        score,
        tuple(tracks) if len(tracks) == len(boxes) and len(set(tracks)) == len(tracks) else (),
    )


def to_boxes(detections: Detections, token: str, world_SE3_ego: Poses) -> list[dict[str, Any]]:
    """Convert the boxes of one frame to boxes of a results file."""
    pose = world_SE3_ego @ detections.ego_SE3_box
    if not len(detections):
        return []
    velocity = rotate(world_SE3_ego.rotation, np.nan_to_num(detections.velocity_mps))
    rows = []
    for row in range(len(detections)):
        length, width, height = detections.size_m[row].tolist()
        known = bool(np.isfinite(detections.velocity_mps[row, :2]).all())
        score = float(detections.score[row])
        box = {
            "sample_token": token,
            "translation": pose.translation[row].tolist(),
            "size": [width, length, height],
            "rotation": pose.rotation[row].tolist(),
            "velocity": np.asarray(velocity[row])[:2].tolist() if known else [None, None],
            "detection_name": detections.category[row],
            "detection_score": -1.0 if np.isnan(score) else score,
            "attribute_name": "",
        }
        if detections.track_id:
            box["tracking_id"] = detections.track_id[row]
        rows.append(box)
    return rows


def write_results(path: Path, results: Mapping[str, Sequence[Mapping[str, Any]]], meta: Mapping[str, Any]) -> None:
    """Write a results file.

    Raises:
        DatasetError: the file cannot be written.
    """
    write_bytes(path, json.dumps({"meta": {**_META, **meta}, "results": results}, indent=1).encode())


def frame_token(frame: Frame) -> str:
    """Return the sample token of a frame."""
    return sample_token(frame.traversal_id, frame.timestamp_ns)


def _numbers(boxes: Sequence[Mapping[str, Any]], key: str, count: int, default: float | None = None) -> Any:
    rows = np.empty((len(boxes), count))
    for number, box in enumerate(boxes):
        value = box.get(key)
        if value is None and default is not None:
            rows[number] = default
            continue
        values = value if isinstance(value, list) else [value]
        if default is not None:
            values = [default if item is None else item for item in values]
        if len(values) != count or any(isinstance(item, bool) or not isinstance(item, int | float) for item in values):
            raise AnnotationError(
                f"{value!r}", place=f"box {number}: {key}", expected=f"{count} number{'s' * (count > 1)}"
            )
        rows[number] = values
    return rows
