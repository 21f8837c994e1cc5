"""Writes drives as the components of Waymo v2: one Parquet file for each component and segment."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import matrix_from_quaternion, quaternion_inverse, quaternion_multiply
from tests.recordings.formats.street import StreetDrive

CAMERAS = {"front_wide": 1, "front_left": 2, "front_right": 3, "rear_left": 4, "rear_right": 5}
DISTORTION = {"k1": -0.35, "k2": 0.16, "p1": 0.0003, "p2": -0.0002, "k3": -0.04}
SHUTTER_S, READOUT_S = 0.004, 0.030
# Axes of Waymo's cameras, x forward, y left, z up, in ours.
_CAMERA_FROM_WAYMO = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def matrices(poses: Poses) -> np.ndarray:
    """(N, 4, 4) matrices of poses."""
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = matrix_from_quaternion(poses.rotation), poses.translation
    return out


def write_waymo(root: Path, drives: Sequence[StreetDrive]) -> Path:
    """Write a segment for each drive, and return the folder. The drives' world is the segment's."""
    for drive in drives:
        _write_segment(root, drive)
    return root


def _write_segment(root: Path, drive: StreetDrive) -> None:
    segment = f"{drive.name}_000_020"
    names = [name for name in drive.cameras if name in CAMERAS]
    key = {"key.segment_context_name": segment}

    def write(component: str, columns: dict[str, Any], count: int, rows: int = 1_000) -> None:
        table = pa.table({**{name: [value] * count for name, value in key.items()}, **columns})
        (root / component).mkdir(parents=True, exist_ok=True)
        pq.write_table(table, root / component / f"{segment}.parquet", row_group_size=rows)

    write(
        "vehicle_pose",
        {
            "key.frame_timestamp_micros": drive.pose_ns // 1_000,
            "[VehiclePoseComponent].world_from_vehicle.transform": transforms(matrices(drive.poses)),
        },
        len(drive.pose_ns),
    )
    lens = "[CameraCalibrationComponent]."
    cameras = [drive.cameras[name] for name in names]
    mountings = np.concatenate([matrices(drive.ego_SE3_camera[name]) @ _CAMERA_FROM_WAYMO for name in names])
    write(
        "camera_calibration",
        {
            "key.camera_name": pa.array([CAMERAS[name] for name in names], pa.int8()),
            f"{lens}intrinsic.f_u": [camera.fx_px for camera in cameras],
            f"{lens}intrinsic.f_v": [camera.fy_px for camera in cameras],
            f"{lens}intrinsic.c_u": [camera.cx_px for camera in cameras],
            f"{lens}intrinsic.c_v": [camera.cy_px for camera in cameras],
            **{f"{lens}intrinsic.{name}": [value] * len(names) for name, value in DISTORTION.items()},
            f"{lens}extrinsic.transform": transforms(mountings),
            f"{lens}width": pa.array([camera.width_px for camera in cameras], pa.int32()),
            f"{lens}height": pa.array([camera.height_px for camera in cameras], pa.int32()),
            f"{lens}rolling_shutter_direction": pa.array([2] * len(names), pa.int8()),
        },
        len(names),
    )
    _write_images(write, drive, names)
    _write_boxes(write, drive)
    write(
        "stats",
        {
            "key.frame_timestamp_micros": drive.pose_ns[:1] // 1_000,
            "[StatsComponent].time_of_day": [{"day": "Day", "night": "Night"}[drive.light]],
            "[StatsComponent].location": ["location_sf"],
            "[StatsComponent].weather": [{"clear": "sunny", "rain": "rain"}[drive.weather]],
            **{
                f"[StatsComponent].{sensor}_object_counts.{name}": pa.array([[value]], pa.list_(kind))
                for sensor in ("lidar", "camera")
                for name, value, kind in (("types", 1, pa.int8()), ("counts", len(drive.objects), pa.int32()))
            },
        },
        1,
    )


def _write_images(write: Any, drive: StreetDrive, names: list[str]) -> None:
    """Rows in order of frames and cameras; the stamp of an image is the middle of its exposure."""
    rows = [(index, name) for index in range(len(drive.image_ns[names[0]])) for name in names]
    stamps = np.array([drive.image_ns[name][index] for index, name in rows])
    image = "[CameraImageComponent]."
    linear, angular = _velocities(drive, stamps)
    half = (SHUTTER_S + READOUT_S) / 2
    write(
        "camera_image",
        {
            "key.frame_timestamp_micros": stamps // 1_000,
            "key.camera_name": pa.array([CAMERAS[name] for _, name in rows], pa.int8()),
            f"{image}image": [drive.image(name, index) for index, name in rows],
            f"{image}pose.transform": transforms(matrices(drive.poses_at(stamps))),
            **{
                f"{image}velocity.linear_velocity.{axis}": pa.array(values, pa.float32())
                for axis, values in zip("xyz", linear.T)
            },
            **{f"{image}velocity.angular_velocity.{axis}": values for axis, values in zip("xyz", angular.T)},
            f"{image}pose_timestamp": stamps * 1e-9,
            f"{image}rolling_shutter_params.shutter": [SHUTTER_S] * len(rows),
            f"{image}rolling_shutter_params.camera_trigger_time": stamps * 1e-9 - half,
            f"{image}rolling_shutter_params.camera_readout_done_time": stamps * 1e-9 + half,
        },
        len(rows),
        100,
    )


def _velocities(drive: StreetDrive, stamps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) metres and radians per second in the world, from poses 2 ms apart."""
    step = 1_000_000
    before, after = drive.poses_at(stamps - step), drive.poses_at(stamps + step)
    turn = quaternion_multiply(after.rotation, quaternion_inverse(before.rotation))
    seconds = 2e-9 * step
    return (
        (after.translation - before.translation) / seconds,
        2.0 * turn[:, 1:] * np.sign(turn[:, :1]) / seconds,
    )


def _write_boxes(write: Any, drive: StreetDrive) -> None:
    parts: dict[str, list[Any]] = {}
    ego = drive.poses_at(drive.box_ns)
    box = "[LiDARBoxComponent]."
    for one in drive.objects:
        seen = ego.inverse() @ one.world_SE3_box
        ahead = matrix_from_quaternion(seen.rotation)[:, :, 0]
        columns = {
            "key.frame_timestamp_micros": (drive.box_ns // 1_000).tolist(),
            "key.laser_object_id": [one.track_id] * len(drive.box_ns),
            f"{box}type": [1] * len(drive.box_ns),
            f"{box}box.heading": np.arctan2(ahead[:, 1], ahead[:, 0]).tolist(),
            **{f"{box}box.center.{axis}": values.tolist() for axis, values in zip("xyz", seen.translation.T)},
            **{f"{box}box.size.{axis}": [size] * len(drive.box_ns) for axis, size in zip("xyz", one.size_m)},
            f"{box}num_lidar_points_in_box": [100] * len(drive.box_ns),
            f"{box}num_top_lidar_points_in_box": [60] * len(drive.box_ns),
        }
        for name, values in columns.items():
            parts.setdefault(name, []).extend(values)
    count = len(parts["key.laser_object_id"])
    parts[f"{box}type"] = pa.array(parts[f"{box}type"], pa.int8())
    # The dataset does not state the frame of these vectors, and the reader leaves them out.
    for name in ("speed", "acceleration"):
        parts.update({f"{box}{name}.{axis}": pa.nulls(count, pa.float64()) for axis in "xyz"})
    for name in ("detection", "tracking"):
        parts[f"{box}difficulty_level.{name}"] = pa.nulls(count, pa.int8())
    write("lidar_box", parts, count)


def transforms(matrix: np.ndarray) -> pa.Array:
    """A column of 16 numbers for each (N, 4, 4) matrix."""
    return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(matrix).reshape(-1)), 16)
