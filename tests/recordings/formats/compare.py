"""Compares a recording with the drive that it was written from: poses, calibrations, stamps, boxes and projections."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.geometry.cameras import camera_from_row
from mirror.geometry.poses import COLUMNS, Poses
from mirror.geometry.quaternions import quaternion_inverse, quaternion_multiply, rotate
from mirror.recordings.protocol import Recording
from mirror.schema.files import conform
from mirror.schema.tables import BOXES, CALIBRATIONS
from tests.recordings.formats.street import StreetDrive


@dataclass(frozen=True)
class Tolerances:
    """Largest deviations that a format's rounding explains."""

    position_m: float = 2e-6
    angle_rad: float = 1e-8
    pixel_px: float = 1e-5
    stamp_ns: int = 0


@dataclass(frozen=True)
class Frame:
    """How a test reads the track in the drive's metric world.

    Attributes:
        to_world: from the track to (N, 3) metres and (N, 4) ``world_SE3_ego``.
    """

    to_world: Callable[[Recording], tuple[Int64, Poses]]
    names: dict[str, str] = field(default_factory=dict)


def angle_between(first: Float64, second: Float64) -> Float64:
    """(N,) angles in radians between rotations."""
    return 2.0 * np.linalg.norm(quaternion_multiply(quaternion_inverse(first), second)[:, 1:], axis=1)


def compare_poses(stamps: Int64, found: Poses, drive: StreetDrive, tolerances: Tolerances) -> None:
    """Every pose of a recording is the true pose at its stamp, and the drive's poses are among them."""
    truth = drive.poses_at(stamps)
    assert set(drive.pose_ns.tolist()) <= set(stamps.tolist())
    assert np.abs(found.translation - truth.translation).max() < tolerances.position_m
    assert angle_between(found.rotation, truth.rotation).max() < tolerances.angle_rad


def compare_cameras(recording: Recording, drive: StreetDrive, names: dict[str, str], tolerances: Tolerances) -> None:
    """Calibrations, image stamps and bytes are the drive's; ``names`` maps the recording's cameras to the drive's."""
    table = conform(recording.calibrations(), CALIBRATIONS, file="calibrations")
    assert recording.rig is not None
    assert {camera.name for camera in recording.rig.cameras} == set(names)
    rows = {row["camera"]: row for row in table.to_pylist()}
    streams = recording.images()
    assert set(rows) == set(streams) == set(names)
    for name, of_drive in names.items():
        lens, mounting = drive.cameras[of_drive], drive.ego_SE3_camera[of_drive]
        found = camera_from_row(rows[name])
        found_mounting = Poses.from_columns({column: [rows[name][column]] for column in COLUMNS})
        points = np.array([[0.1, -0.2, 1.0], [-0.3, 0.15, 1.0], [0.0, 0.0, 1.0]])
        assert np.abs(found.project(points).uv_px - lens.project(points).uv_px).max() < tolerances.pixel_px
        assert np.abs(found_mounting.translation - mounting.translation).max() < tolerances.position_m
        assert angle_between(found_mounting.rotation, mounting.rotation).max() < tolerances.angle_rad
        stream = streams[name]
        middle = stream.exposure_start_ns + (stream.exposure_end_ns - stream.exposure_start_ns) // 2
        assert np.abs(middle - drive.image_ns[of_drive]).max() <= tolerances.stamp_ns
        for index, data in stream.read([0, len(middle) - 1]):
            assert data == drive.image(of_drive, index, ".png" if stream.codec == "png" else ".jpg")


def compare_boxes(
    recording: Recording, drive: StreetDrive, track_id: Callable[[str], str], tolerances: Tolerances
) -> dict[str, np.ndarray]:
    """Boxes in the world are the drive's; returns velocities in the world by the drive's track ids, NaN: unknown."""
    boxes = recording.boxes()
    assert boxes is not None
    rows = conform(boxes, BOXES, file="boxes").to_pylist()
    assert len(rows) == len(drive.objects) * len(drive.box_ns)
    velocities = {}
    for one in drive.objects:
        mine = sorted(
            (row for row in rows if row["track_id"] == track_id(one.track_id)), key=lambda row: row["timestamp_ns"]
        )
        stamps = np.array([row["timestamp_ns"] for row in mine])
        assert np.abs(stamps - drive.box_ns).max() <= tolerances.stamp_ns
        ego_SE3_box = Poses.from_columns({name: [row[name] for row in mine] for name in COLUMNS})
        ego = drive.poses_at(drive.box_ns)
        world_SE3_box = ego @ ego_SE3_box
        assert np.abs(world_SE3_box.translation - one.world_SE3_box.translation).max() < tolerances.position_m
        assert angle_between(world_SE3_box.rotation, one.world_SE3_box.rotation).max() < tolerances.angle_rad
        size = np.array([[row[name] for name in ("length_m", "width_m", "height_m")] for row in mine])
        assert np.abs(size - one.size_m).max() < tolerances.position_m
        speed = [
            [np.nan if row[name] is None else row[name] for name in ("vx_mps", "vy_mps", "vz_mps")] for row in mine
        ]
        velocities[one.track_id] = rotate(ego.rotation, np.array(speed, np.float64))
    return velocities
