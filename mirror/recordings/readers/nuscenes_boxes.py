"""Boxes of a nuScenes scene: from the map's frame to the ego's, with velocities from their neighbours in time."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64, Int64
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_inverse, rotate
from mirror.recordings.coordinates import is_invalid_rotation
from mirror.recordings.readers.box_rows import make_box_table, velocity_columns
from mirror.recordings.readers.nuscenes_rows import Annotations
from mirror.recordings.readers.stored_poses import poses_at, require_poses, select_poses

# The devkit's limits: a neighbour may be 1.5 s away, two neighbours 3 s apart.
_FARTHEST_US: Final = 1_500_000


def make_boxes(
    annotations: Annotations,
    instances: tuple[list[str], list[str]],
    pose_us: Int64,
    rotation: Float64,
    translation: Float64,
    *,
    version: str,
    file: Path,
) -> pa.Table:
    """Make rows of the ``boxes`` table.

    Args:
        annotations: of one scene, sorted by instance and time; K rows.
        instances: tokens and categories of all instances.
        pose_us: (M,) stamps of the scene's poses, in any order.
        rotation: (M, 4) ``map_SE3_ego``, as written.
        translation: (M, 3) metres.
        version: the name of the version folder.
        file: the table of annotations, for messages.

    Returns:
        K rows; the velocity is null where an instance has no neighbour that is near enough in time.

    Raises:
        RecordingError: a box has no rotation, or no pose is valid.
    """
    names, categories = instances

    def place(row: int) -> str:
        return f"instance {names[int(annotations.instance[row])]} at {annotations.timestamp_us[row]} us"

    map_SE3_box = require_poses(annotations.rotation, annotations.translation, file=file, place=place)
    map_SE3_ego = _ego_at(annotations.timestamp_us, pose_us, rotation, translation, file)
    velocity = rotate(quaternion_inverse(map_SE3_ego.rotation), velocities(annotations))
    columns = {
        "timestamp_ns": annotations.timestamp_us * 1_000,
        "track_id": [names[index] for index in annotations.instance.tolist()],
        "category": [categories[index] for index in annotations.instance.tolist()],
        **velocity_columns(velocity),
        "attributes": annotations.attributes,
        "source": "nuscenes",
        "source_version": version,
    }
    width, length, height = annotations.size_m.T
    return make_box_table(map_SE3_ego.inverse() @ map_SE3_box, np.stack([length, width, height], axis=1), columns)


def velocities(annotations: Annotations) -> Float64:
    """Return the velocities (K, 3) in the map's frame, m/s.

    They are between the neighbours of a box, or to the only one; else NaN.

    Source: ``box_velocity`` of the devkit, with its limits of 1.5 s to one neighbour and 3 s between two.
    """
    stamps, instance = annotations.timestamp_us, annotations.instance
    number = np.arange(len(stamps))
    joined = instance[1:] == instance[:-1]
    before = np.where(np.concatenate([[False], joined]), number - 1, number)
    after = np.where(np.concatenate([joined, [False]]), number + 1, number)
    apart_us = stamps[after] - stamps[before]
    both = (before < number) & (after > number)
    known = (apart_us > 0) & (apart_us <= np.where(both, 2 * _FARTHEST_US, _FARTHEST_US))
    moved = annotations.translation[after] - annotations.translation[before]
    return np.where(known[:, None], moved / np.where(known, apart_us * 1e-6, 1.0)[:, None], np.nan)


def _ego_at(stamps_us: Int64, pose_us: Int64, rotation: Float64, translation: Float64, file: Path) -> Poses:
    """The ego's poses at the stamps of frames; a stamp before the first or after the last pose has that pose."""
    good = ~is_invalid_rotation(rotation) & np.isfinite(translation).all(axis=1)
    times, rows = select_poses(pose_us, good, file.with_name("ego_pose.json"))
    return poses_at(stamps_us, times, Poses(rotation[rows], translation[rows]))
