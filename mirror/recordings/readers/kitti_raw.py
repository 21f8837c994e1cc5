"""KITTI raw: drives of a station wagon in Karlsruhe, with a GNSS and inertial receiver, four cameras and boxes.

Facts of the format, from the development kit (``readme.txt``, ``oxts/dataformat.txt``):

- ``<date>/<date>_drive_NNNN_sync`` holds rectified images, of which all cameras have the same frames;
  ``<date>_drive_NNNN_extract`` those of the sensors as they are. The calibration of a day lies in ``<date>``.
- ``oxts/data/FFFFFFFFFF.txt`` is one fix: 30 numbers, of which the first six are latitude, longitude, altitude, roll,
  pitch and yaw of the receiver, x forward, y left, z up. Roll is positive with the left side up, pitch with the front
  down, yaw counter-clockwise from east: ``enu_R_receiver = Z(yaw) Y(pitch) X(roll)``. Number 24 is the accuracy of the
  position in metres.
- The stamp of a fix or an image is the line of its number in ``timestamps.txt`` of its sensor: date and time without a
  zone.
- Cameras are read in `kitti_raw_cameras`, boxes in `kitti_tracklets`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.geometry.quaternions import quaternion_exp, quaternion_multiply
from mirror.recordings.calibration import to_calibration_table
from mirror.recordings.coordinates import to_ego_track
from mirror.recordings.lidars import LidarSweeps, repeat_pose
from mirror.recordings.on_road import above_road
from mirror.recordings.opening import find_file, read_file
from mirror.recordings.paths import list_folder, to_identifier
from mirror.recordings.protocol import CameraInfo, DriveInfo, ImageStream, RigInfo, Track
from mirror.recordings.readers.collection import one_of
from mirror.recordings.readers.kitti_files import (
    NO_STAMP,
    RECEIVER_HEIGHT_M,
    list_numbered_files,
    read_frame_stamps,
    stamps_of_frames,
    to_frame_stream,
)
from mirror.recordings.readers.kitti_raw_cameras import CALIBRATION_FILES, read_calibrations, read_lidar_pose
from mirror.recordings.readers.kitti_tracklets import read_tracklets
from mirror.recordings.readers.stored_poses import REMEDY
from mirror.recordings.registry import refuse_options
from mirror.recordings.row_faults import RowFaults

CAMERAS: Final = ("image_00", "image_01", "image_02", "image_03")
"""Folders of the cameras: two grey ones, two colour ones."""

_DATE: Final = re.compile(r"\d{4}_\d{2}_\d{2}")
_DRIVE: Final = re.compile(r"(\d{4}_\d{2}_\d{2})_drive_\d{4}_(sync|extract)")
_BOXES: Final = "tracklet_labels.xml"
_LIDAR: Final = "velodyne_points"
_SUFFIXES: Final = ("png", "jpg")
_DIGITS: Final = 10
_NUMBERS: Final = 30
_SIGMA: Final = 23
_FIX: Final = "one line of 30 numbers: latitude, longitude, altitude, roll, pitch, yaw, ..."
_HEIGHTS: Final = (
    "altitudes of the receiver are taken as ellipsoidal; in Karlsruhe they are about 48 m less, as heights above sea "
    "level are"
)


class KittiRawReader:
    """A reader of the drives of a day, or of a single drive."""

    name = "kitti_raw"
    expects = "a folder YYYY_MM_DD with calib_cam_to_cam.txt and drives YYYY_MM_DD_drive_NNNN_sync, or such a drive"

    def recognises(self, path: Path) -> bool:
        """Return whether the folder is a drive, or a day with drives, judged by names of folders."""
        return _is_drive(path) or bool(_drives_of_day(path))

    def drives(self, path: Path) -> Sequence[str]:
        """Return the names of the drives of a day."""
        return [path.name] if _is_drive(path) else _drives_of_day(path)

    def open(self, path: Path, options: Mapping[str, str]) -> KittiRawRecording:
        """Open a drive.

        The option ``tz`` is the zone of the stamps, which the data set does not state (``UTC``, or an IANA name);
        ``boxes`` is ``yes`` or ``no``.
        """
        refuse_options(options, ("tz", "boxes"), path, self.name)
        drives = _drives_of_day(path)
        if len(drives) == 1:
            path = path / drives[0]
        if not _is_drive(path):
            named = f"a day with {len(drives)} drives" if drives else "no drive of KITTI raw"
            remedy = f"name one, as in {path / drives[0]}" if drives else "name a folder of this layout"
            raise RecordingError(named, file=path, expected=self.expects, remedy=remedy)
        path = path.resolve()
        has_boxes = one_of(options, "boxes", ("yes", "no"), path) == "yes"
        return KittiRawRecording(path.parent, path.name, options.get("tz", "UTC"), has_boxes)


def _is_drive(path: Path) -> bool:
    return _DRIVE.fullmatch(path.resolve().name) is not None and any(
        (path / name).is_dir() for name in ("oxts", *CAMERAS)
    )


def _drives_of_day(path: Path) -> list[str]:
    if _DATE.fullmatch(path.resolve().name) is None or not path.is_dir():
        return []
    return sorted(child.name for child in path.iterdir() if _is_drive(child))


@dataclass(frozen=True)
class KittiRawRecording:
    """One drive.

    Attributes:
        root: the folder of the day, which holds the calibration.
        drive: the drive's name.
        tz: the zone of its stamps.
        has_boxes: whether boxes are read.
    """

    root: Path
    drive: str
    tz: str
    has_boxes: bool

    @property
    def is_rectified(self) -> bool:
        """Return whether the images are rectified."""
        return self.drive.endswith("_sync")

    @cached_property
    def info(self) -> DriveInfo:
        """The drive; all drives have the same vehicle."""
        return DriveInfo(
            drive_id=to_identifier(f"kitti_{self.drive}"),
            vehicle_id="kitti",
            vehicle_type="station wagon",
            time_base=f"date and time, taken as {self.tz}",
            body_frame="imu",
            city="Karlsruhe",
            licence="CC BY-NC-SA 3.0",
            notes=(_HEIGHTS,),
        )

    def _stamps(self, sensor: str) -> tuple[Path, Int64]:
        """The stamp of each frame of a sensor; `NO_STAMP` where a line is none."""
        name = f"{self.drive}/{sensor}/timestamps.txt"
        file = find_file(self.root, name)
        if file is None:
            raise RecordingError(
                "missing",
                file=self.root / name,
                expected="the stamps of its frames",
                remedy=f"download {self.drive} again",
            )
        return file, read_frame_stamps(file, self.tz)

    @cached_property
    def _files(self) -> dict[str, dict[int, Path]]:
        """Images by camera and frame."""
        found = {}
        for camera in CAMERAS:
            folder = self.root / self.drive / camera / "data"
            if files := list_numbered_files(self.root, folder, _DIGITS, _SUFFIXES):
                found[camera] = files
        return found

    @cached_property
    def _fixes(self) -> dict[int, Path]:
        """Files of the receiver by their number, ascending."""
        folder = self.root / self.drive / "oxts" / "data"
        if not folder.is_dir():
            raise RecordingError(
                "missing",
                file=folder,
                expected="the files of the receiver: without them the drive has no poses",
                remedy=f"download {self.drive} again",
            )
        files = {}
        for name, file in list_folder(self.root, folder).items():
            stem, _, suffix = name.rpartition(".")
            if suffix != "txt" or not stem.isdecimal() or len(stem) != _DIGITS:
                raise RecordingError(
                    "no fix of the receiver", file=file, expected="ten digits and .txt", remedy="move it elsewhere"
                )
            files[int(stem)] = file
        return dict(sorted(files.items()))

    @cached_property
    def rig(self) -> RigInfo | None:
        """The cameras that have images."""
        cameras = tuple(CameraInfo(camera, camera) for camera in self._files)
        if not cameras:
            return None
        kind = "kitti_raw" if self.is_rectified else "kitti_raw_distorted"
        return RigInfo("_".join((kind, *self._files)), cameras, cameras[0].name)

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the fixes, stamps, calibrations, boxes and images of the drive."""
        names = [*CALIBRATION_FILES, f"{self.drive}/oxts/timestamps.txt"]
        names += [f"{self.drive}/{sensor}/timestamps.txt" for sensor in (*CAMERAS, _LIDAR)]
        names += [f"{self.drive}/{_BOXES}"] if self.has_boxes else []
        files = [(name, file) for name in names if (file := find_file(self.root, name)) is not None]
        others = [*self._fixes.values(), *(file for by_frame in self._files.values() for file in by_frame.values())]
        return sorted([*files, *((file.relative_to(self.root).as_posix(), file) for file in others)])

    def track(self) -> Track:
        """Return the poses of the point on the road below the receiver, with the accuracy that it states for each."""
        files = list(self._fixes.values())
        frames = np.fromiter(self._fixes, np.int64, len(files))
        place, by_frame = self._stamps("oxts")
        values = np.full((len(files), _NUMBERS), np.nan)
        for row, file in enumerate(files):
            words = read_file(file).split()
            if len(words) == _NUMBERS:
                try:
                    values[row] = [float(word) for word in words]
                except ValueError:
                    values[row] = np.nan
        faults = RowFaults(len(files))

        def no_fix(row: int) -> RecordingError:
            return RecordingError("no fix", file=files[row], expected=_FIX, remedy=REMEDY)

        def no_stamp(row: int) -> RecordingError:
            expected = f"a date and time in line {frames[row] + 1} of {place.name}"
            return RecordingError("the fix has no stamp", file=files[row], expected=expected, remedy=REMEDY)

        def no_place(row: int) -> RecordingError:
            return RecordingError(
                f"latitude {values[row, 0]:g}, longitude {values[row, 1]:g}, altitude {values[row, 2]:g} m",
                file=files[row],
                expected="degrees of WGS 84 and a height on the earth",
                remedy=REMEDY,
            )

        def no_angles(row: int) -> RecordingError:
            return RecordingError(
                f"roll, pitch and yaw {values[row, 3:6].tolist()}",
                file=files[row],
                expected="radians within a turn",
                remedy=REMEDY,
            )

        faults.add(~np.isfinite(values).all(axis=1), "cells", no_fix)
        inside = frames < len(by_frame)
        stamps: Int64 = np.where(inside, by_frame[np.where(inside, frames, 0)] if len(by_frame) else 0, NO_STAMP)
        faults.add(stamps == NO_STAMP, "time", no_stamp)
        latitude, longitude, height = values[:, :3].T
        on_earth = (np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 180.0) & (np.abs(height) < 1e5)
        faults.add(~on_earth, "position", no_place)
        faults.add(~(np.abs(values[:, 3:6]) <= 2.0 * np.pi).all(axis=1), "rotation", no_angles)
        faults.add(~(values[:, _SIGMA] >= 0.0), "sigma", no_fix)
        angles = np.where(faults.good[:, None], values[:, 3:6], 0.0)
        roll, pitch, yaw = (quaternion_exp(np.outer(angles[:, axis], np.eye(3)[axis])) for axis in range(3))
        receiver = faults.drop_from(
            Track(
                np.where(stamps == NO_STAMP, 0, stamps),
                longitude_deg=longitude,
                latitude_deg=latitude,
                height_m=height,
                rotation=quaternion_multiply(yaw, quaternion_multiply(pitch, roll)),
                sigma_m=values[:, _SIGMA],
                file=self.root / self.drive / "oxts" / "data",
            )
        )
        return replace(to_ego_track(receiver, above_road(RECEIVER_HEIGHT_M)), bad=receiver.bad)

    def calibrations(self) -> pa.Table:
        """Return the cameras that have images."""
        calibrations = read_calibrations(self.root, list(self._files), rectified=self.is_rectified)
        return to_calibration_table(calibrations, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def images(self) -> Mapping[str, ImageStream]:
        """Return the images; each camera has stamps of its own."""
        streams = {}
        for camera, files in self._files.items():
            place, by_frame = self._stamps(camera)
            streams[camera] = to_frame_stream(camera, files, by_frame, place, f"download {self.drive} again")
        return streams

    def boxes(self) -> pa.Table | None:
        """Return the boxes of the tracklets, at the stamps of the first camera, else of the lidar."""
        file = find_file(self.root, f"{self.drive}/{_BOXES}") if self.has_boxes else None
        if file is None:
            return None
        _, by_frame = self._stamps(next(iter(self._files), _LIDAR))
        return read_tracklets(file, by_frame, read_lidar_pose(self.root))

    def lidars(self) -> Sequence[LidarSweeps]:
        """Return the sweeps of ``velodyne_points``, at the instants at which the scanner faces forward."""
        folder = self.root / self.drive / _LIDAR / "data"
        files = list_numbered_files(self.root, folder, _DIGITS, ("bin", "txt"), "sweep of the lidar")
        if not files:
            return ()
        place, by_frame = self._stamps(_LIDAR)
        stamps = stamps_of_frames(files, by_frame, place, f"download {self.drive} again")
        uris = tuple(str(file.absolute()) for file in files.values())
        form = f"kitti_velodyne_{next(iter(files.values())).suffix[1:]}"
        pose = repeat_pose(read_lidar_pose(self.root), len(files))
        return (LidarSweeps("velodyne", form, stamps, uris, pose),)
