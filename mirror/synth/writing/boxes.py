"""The 3D boxes of road users in a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Bool, Float64, Int64
from mirror.geometry import Poses, matrix_from_quaternion, project_boxes, quaternion_from_heading_pitch_roll
from mirror.schema.files import conform
from mirror.schema.tables import BOXES
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.road_users.body import RoadUser
from mirror.synth.writing.schedule import ImageSchedule
from mirror.traffic.placement.motion import Placement
from mirror.version import __version__

SOURCE: Final = "synth"
LEAST_SHARE: Final = 8e-5
"""A road user has a box if some image shows it with at least this share of the image's pixels."""
_DECIMALS: Final = 9
_FARTHEST_M: Final = 60.0
_APART_NS: Final = 500_000_000


def world_SE3_boxes(road_users: Sequence[RoadUser], placements: Sequence[Placement]) -> Poses:  # noqa: N802
    """Return the poses (N,) of the road users' boxes: origin in the middle of the box, axes of the body."""
    rows = [
        (placement.x_m, placement.y_m, placement.z_m, placement.yaw_rad, placement.pitch_rad, placement.roll_rad)
        for placement in placements
    ]
    return _fit_boxes(np.array(rows).reshape(-1, 6), np.array([user.body.size_m[2] for user in road_users]))


def _fit_boxes(placed: Float64, height_m: Float64) -> Poses:
    """Box poses of placements (N, 6): x, y, z, yaw, pitch, roll."""
    yaw, pitch, roll = np.degrees(placed[:, 3:]).T
    body = Poses(quaternion_from_heading_pitch_roll(90.0 - yaw, pitch, roll), placed[:, :3])
    up = np.zeros((len(placed), 3))
    up[:, 2] = 0.5 * height_m
    return body @ Poses(np.tile((1.0, 0.0, 0.0, 0.0), (len(placed), 1)), up)


def make_box_rows(
    road_users: Sequence[RoadUser], placements: Sequence[Placement], world_SE3_ego: Poses, timestamp_ns: int
) -> pa.Table:
    """Return the rows of the ``boxes`` table for road users at one instant.

    Args:
        road_users: the road users.
        placements: placement of each road user.
        world_SE3_ego: one pose of the recording vehicle.
        timestamp_ns: timestamp of the rows.
    """
    speed = np.array([placement.speed_mps for placement in placements])
    return _make_table(
        road_users, np.full(len(road_users), timestamp_ns), world_SE3_ego[np.zeros(len(road_users), np.int64)],
        world_SE3_boxes(road_users, placements), speed,
    )  # fmt: skip


def boxes_in_view(drive: SynthDrive, schedule: ImageSchedule) -> pa.Table:
    """Return the rows of the ``boxes`` table of a drive without rendered images.

    Twice a second, a nearby road user has a row if its projected box is large enough in the image of some camera.
    Occlusion is not considered.
    """
    camera = next(iter(schedule.true_ns))
    every = max(round(_APART_NS * drive.preset.image_hz * 1e-9), 1)
    true, recorded = schedule.true_ns[camera][::every], schedule.recorded_ns[camera][::every]
    ego = drive.world_SE3_ego(true)
    parts = [BOXES.schema.empty_table()]
    for user in drive.road_users:
        placed, speed = drive.placements(user, true)
        rows = np.flatnonzero(np.linalg.norm(placed[:, :2] - ego.translation[:, :2], axis=1) < _FARTHEST_M)
        boxes = _fit_boxes(placed[rows], np.full(len(rows), user.body.size_m[2]))
        in_view = _in_view(drive, ego[rows].inverse() @ boxes, user.body.size_m)
        kept = rows[in_view]
        parts.append(_make_table([user] * len(kept), recorded[kept], ego[kept], boxes[in_view], speed[kept]))
    return pa.concat_tables(parts)


def _in_view(drive: SynthDrive, ego_SE3_box: Poses, size_m: tuple[float, float, float]) -> Bool:
    """Return whether some camera has each of N boxes in view, large enough: (N,)."""
    in_view = np.zeros(len(ego_SE3_box), np.bool_)
    for name, camera in drive.vehicle.cameras.items():
        rows = np.flatnonzero(~in_view)
        camera_SE3_box = drive.vehicle.ego_SE3_camera[name].inverse() @ ego_SE3_box[rows]
        projected = project_boxes(camera, camera_SE3_box, np.tile(size_m, (len(rows), 1)))
        area = np.prod(projected.bounds_px[:, 2:] - projected.bounds_px[:, :2], axis=1)
        in_view[rows] = projected.visible & (np.nan_to_num(area) >= least_px(drive))
    return in_view


def least_px(drive: SynthDrive) -> float:
    """Return the least number of pixels of a road user in an image for the road user to have a box."""
    camera = next(iter(drive.vehicle.cameras.values()))
    return max(4.0, LEAST_SHARE * camera.width_px * camera.height_px)


def _make_table(
    road_users: Sequence[RoadUser], timestamp_ns: Int64, world_SE3_ego: Poses, world_SE3_box: Poses, speed_mps: Float64
) -> pa.Table:
    count = len(road_users)
    if not count:
        return BOXES.schema.empty_table()
    ahead = matrix_from_quaternion(world_SE3_box.rotation)[:, :, 0] * speed_mps[:, None]
    velocity = np.einsum("nij,ni->nj", matrix_from_quaternion(world_SE3_ego.rotation), ahead)
    # Rounded, because processors differ in the last bit (see `mirror.portable`).
    columns: Mapping[str, Any] = {
        "timestamp_ns": timestamp_ns,
        "track_id": [user.track_id for user in road_users],
        "category": [user.body.category for user in road_users],
        **{
            name: values.round(_DECIMALS)
            for name, values in (world_SE3_ego.inverse() @ world_SE3_box).to_columns().items()
        },
        **dict(zip(("length_m", "width_m", "height_m"), np.array([user.body.size_m for user in road_users]).T)),
        **dict(zip(("vx_mps", "vy_mps", "vz_mps"), velocity.round(_DECIMALS).T)),
        "score": pa.nulls(count, pa.float64()),
        "source": [SOURCE] * count,
        "source_version": [__version__] * count,
    }
    return conform(pa.table(columns), BOXES, file=BOXES.place)
