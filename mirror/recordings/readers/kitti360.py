"""KITTI-360: nine long drives through the same suburbs of Karlsruhe, with four cameras, refined poses and boxes.

Facts of the format, from the calibration and conversion scripts that the dataset publishes:

- ``data_poses/<drive>/poses.txt`` holds frame numbers and ``world_SE3_imu``. The IMU is x forward, y right, z down. The
  world is Mercator's projection of a sphere of 6,378,137 m, scaled to metres at its origin, a lake in Karlsruhe:
  x east, y north. Only frames that moved have a pose.
- A frame's time is the line of its number in ``timestamps.txt`` of the first camera: date and time without a zone.
- Two cameras are rectified (`kitti360_cameras`), two are fisheyes at the sides. Boxes are in the world
  (`kitti360_boxes`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_inverse, quaternion_multiply, rotate
from mirror.recordings.calibration import to_calibration_table
from mirror.recordings.coordinates import FLU_FROM_FRD
from mirror.recordings.on_road import OPTION, above_road_note, put_on_road
from mirror.recordings.opening import find_file, require_file
from mirror.recordings.paths import to_identifier
from mirror.recordings.protocol import CameraInfo, DriveInfo, ImageStream, Recording, RigInfo, Track
from mirror.recordings.readers.collection import choose_drive, one_of
from mirror.recordings.readers.kitti360_boxes import find_boxes, read_boxes
from mirror.recordings.readers.kitti360_cameras import CALIBRATION_FILES, CAMERAS, read_calibrations
from mirror.recordings.readers.kitti_files import (
    NO_STAMP,
    list_numbered_files,
    read_frame_stamps,
    read_number_rows,
    to_frame_stream,
)
from mirror.recordings.readers.stored_poses import REMEDY, is_no_rigid_motion, mark_matrices, select_poses, to_poses
from mirror.recordings.registry import refuse_options
from mirror.recordings.row_faults import RowFaults

_POSES: Final = "data_poses"
_IMAGES: Final = "data_2d_raw"
_RECTIFIED: Final = ("image_00", "image_01")
_STAMPS_OF: Final = {
    camera: f"data_timestamps_{'perspective' if camera in _RECTIFIED else 'fisheye'}.zip" for camera in CAMERAS
}
_RADIUS_M: Final = 6378137.0
_ORIGIN: Final = (48.9843445, 8.4295857)
_NUMBERS: Final = 13
_ROTATION_TOLERANCE: Final = 1e-2


class Kitti360Reader:
    """A reader of the drives of a KITTI-360 folder; paths are ``FOLDER/2013_05_28_drive_NNNN_sync``."""

    name = "kitti360"
    expects = f"a KITTI-360 folder with {_POSES}/<drive>/poses.txt and calibration/, or FOLDER/<drive>"

    def recognises(self, path: Path) -> bool:
        """Return whether the folder holds poses and calibrations."""
        return (path / _POSES).is_dir() and (path / "calibration").is_dir()

    def drives(self, path: Path) -> Sequence[str]:
        """Return the names of the drives that have poses."""
        return sorted(
            child.name
            for child in (path / _POSES).iterdir()
            if child.is_dir() and find_file(path, f"{_POSES}/{child.name}/poses.txt")
        )

    def open(self, path: Path, options: Mapping[str, str]) -> Recording:
        """Open a drive.

        The option ``tz`` is the zone of the stamps, which the dataset does not state (``UTC``, or an IANA name).
        ``fisheye`` is ``yes`` (all cameras that have images) or ``no`` (the rectified ones). ``boxes`` is ``movable``
        (road users), ``all`` (also buildings, poles and other objects) or ``no``. ``height_m`` is the height of the IMU
        above the road.
        """
        refuse_options(options, ("tz", "fisheye", "boxes", OPTION), path, self.name)
        root, name = (path, None) if self.recognises(path) else (path.parent, path.name)
        if not self.recognises(root):
            raise RecordingError("no KITTI-360 folder", file=path, expected=self.expects)
        cameras = CAMERAS if one_of(options, "fisheye", ("yes", "no"), path) == "yes" else _RECTIFIED
        kinds = one_of(options, "boxes", ("movable", "all", "no"), path)
        drive = choose_drive(self.drives(root), name, root)
        recording = Kitti360Recording(root, drive, options.get("tz", "UTC"), tuple(cameras), kinds)
        return put_on_road(recording, options, path)


@dataclass(frozen=True)
class Kitti360Recording:
    """One drive of KITTI-360.

    Attributes:
        root: the folder of the dataset.
        drive: the drive's name.
        tz: the zone of its stamps.
        cameras: the cameras to read.
        kinds: the kinds of boxes to read: ``movable``, ``all`` or ``no``.
    """

    root: Path
    drive: str
    tz: str
    cameras: tuple[str, ...]
    kinds: str

    @cached_property
    def info(self) -> DriveInfo:
        """The drive; all drives have the same vehicle."""
        return DriveInfo(
            drive_id=to_identifier(f"kitti360_{self.drive}"),
            vehicle_id="kitti360",
            vehicle_type="station wagon",
            time_base=f"date and time, taken as {self.tz}",
            body_frame="imu",
            city="Karlsruhe",
            licence="CC BY-NC-SA 3.0",
            notes=(above_road_note("imu"),),
        )

    def _stamps(self, camera: str) -> tuple[Path, Int64]:
        """The stamp of each frame of a camera; the smallest int64 where a line is none."""
        file = find_file(self.root, f"{_IMAGES}/{self.drive}/{camera}/timestamps.txt")
        if file is None:
            raise RecordingError(
                "missing",
                file=self.root / _IMAGES / self.drive / camera / "timestamps.txt",
                expected="the stamps of the frames: without them poses and images have no time",
                remedy=f"download {_STAMPS_OF[camera]}",
            )
        return file, read_frame_stamps(file, self.tz)

    @cached_property
    def _files(self) -> dict[str, dict[int, Path]]:
        """Images by camera and frame."""
        found: dict[str, dict[int, Path]] = {}
        for camera in self.cameras:
            folder = self.root / _IMAGES / self.drive / camera / CAMERAS[camera]
            files = list_numbered_files(self.root, folder, 10, ("png",))
            if files:
                found[camera] = files
        return found

    @cached_property
    def rig(self) -> RigInfo | None:
        """The cameras that have images."""
        cameras = tuple(CameraInfo(camera, camera) for camera in self._files)
        if not cameras:
            return None
        names = tuple(camera.name for camera in cameras)
        return RigInfo("kitti360" if names == _RECTIFIED else "_".join(("kitti360", *names)), cameras, names[0])

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the poses, stamps, calibrations, boxes and images of the drive."""
        names = [f"{_POSES}/{self.drive}/poses.txt", *CALIBRATION_FILES]
        names += [
            f"{_IMAGES}/{self.drive}/{camera}/timestamps.txt" for camera in dict.fromkeys((*_RECTIFIED, *self.cameras))
        ]
        files = [(name, file) for name in names if (file := find_file(self.root, name)) is not None]
        boxes = None if self.kinds == "no" else find_boxes(self.root, self.drive)
        if boxes is not None:
            files.append((boxes.relative_to(self.root).as_posix(), boxes))
        images = [file for by_frame in self._files.values() for file in by_frame.values()]
        return sorted([*files, *((file.relative_to(self.root).as_posix(), file) for file in images)])

    @cached_property
    def _poses(self) -> _FramePoses:
        file = require_file(self.root, f"{_POSES}/{self.drive}/poses.txt")
        rows = read_number_rows(file, _NUMBERS, "a frame and a 3x4 matrix")
        values = rows.values
        _, by_frame = self._stamps(_RECTIFIED[0])
        frame = values[:, 0]
        known = (frame >= 0) & (frame < len(by_frame)) & (frame == np.floor(frame))
        stamps: Int64 = np.where(known, by_frame[np.where(known, frame, 0).astype(np.int64)] if len(by_frame) else 0, 0)
        known &= stamps != NO_STAMP
        return _FramePoses(file, frame, stamps, known, values[:, 1:].reshape(-1, 3, 4), rows.torn)

    def track(self) -> Track:
        """Return the IMU's poses, on WGS 84, with axes x forward, y left, z up."""
        rows = self._poses
        file, matrix = rows.file, rows.matrix
        faults = RowFaults(len(matrix), rows.torn)

        def error(row: int) -> RecordingError:
            return RecordingError(
                f"frame {rows.frame[row]:g} with the matrix {matrix[row].tolist()}",
                file=file,
                place=f"pose {row}",
                expected="a frame that timestamps.txt has, and a rigid 3x4 matrix",
                remedy=REMEDY,
            )

        faults.add(~rows.known, "time", error)
        poses, bad = mark_matrices(matrix, _ROTATION_TOLERANCE)
        faults.add(bad, "rotation", error)
        flu = _to_flu(poses).rotation
        up = rotate(flu, (0.0, 0.0, 1.0))[:, 2]
        if faults.good.any() and np.median(up[faults.good]) < 0.0:
            raise RecordingError(
                "the vehicle stands on its head",
                file=file,
                expected="an IMU with z down, in a world with z up",
                remedy=REMEDY,
            )
        longitude, latitude = _to_degrees(poses.translation[:, 0], poses.translation[:, 1])
        return faults.drop_from(
            Track(
                np.where(rows.known, rows.stamps, 0),
                longitude_deg=longitude,
                latitude_deg=latitude,
                height_m=poses.translation[:, 2],
                rotation=flu,
                file=file,
            )
        )

    def calibrations(self) -> pa.Table:
        """Return the cameras that have images."""
        calibrations = read_calibrations(self.root, list(self._files))
        return to_calibration_table(calibrations, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def images(self) -> Mapping[str, ImageStream]:
        """Return the images; a stamp is taken as mid-exposure, exposure lengths are not recorded."""
        streams: dict[str, ImageStream] = {}
        for camera, files in self._files.items():
            place, by_frame = self._stamps(camera)
            remedy = f"download {_STAMPS_OF[camera]} again"
            streams[camera] = to_frame_stream(camera, files, by_frame, place, remedy)
        return streams

    def boxes(self) -> pa.Table | None:
        """Return the boxes of single frames, and static boxes at each frame of their window that is near enough."""
        file = None if self.kinds == "no" else find_boxes(self.root, self.drive)
        if file is None:
            return None
        frames = self._poses
        good = frames.known & ~is_no_rigid_motion(frames.matrix, _ROTATION_TOLERANCE)
        times, rows = select_poses(frames.stamps, good, frames.file)
        poses = _to_flu(to_poses(frames.matrix[rows]))
        _, by_frame = self._stamps(_RECTIFIED[0])
        return read_boxes(file, by_frame, times, poses, all_kinds=self.kinds == "all")


@dataclass(frozen=True)
class _FramePoses:
    """The rows of ``poses.txt``: frames, their stamps where known, matrices, and the lines that are no rows."""

    file: Path
    frame: Float64
    stamps: Int64
    known: Bool
    matrix: Float64
    torn: list[tuple[int, RecordingError]]


def _to_flu(world_SE3_imu: Poses) -> Poses:
    """Turn poses of the IMU, y right and z down, to those of the vehicle, y left and z up."""
    rotation = quaternion_multiply(world_SE3_imu.rotation, quaternion_inverse(FLU_FROM_FRD))
    return Poses(rotation, world_SE3_imu.translation)


def _to_degrees(x_m: Float64, y_m: Float64) -> tuple[Float64, Float64]:
    """Longitude and latitude of the scaled Mercator coordinates of the dataset's world."""
    scale = np.cos(np.radians(_ORIGIN[0])) * _RADIUS_M
    east = scale * np.radians(_ORIGIN[1])
    north = scale * np.log(np.tan(np.radians(90.0 + _ORIGIN[0]) / 2.0))
    with np.errstate(all="ignore"):
        latitude = 2.0 * np.degrees(np.arctan(np.exp((y_m + north) / scale))) - 90.0
        return np.degrees((x_m + east) / scale), latitude
