"""Boreas (University of Toronto): repeated drives of fixed routes, one camera, post-processed GNSS poses.

Facts of the format, checked on the two sequences of the tests:

- ``GPSTime`` counts Unix microseconds in UTC, not GPS time. The dataset's guide states this for all file names, and the
  file names equal the column. Read in this way, sequence ``boreas-2021-08-05-13-34`` (local time, UTC-4) begins at
  17:34:46 UTC.
- ``easting, northing, altitude`` are UTM zone 17 north and ellipsoidal height. Read in this way, the positions lie
  0.3 m from the route that the dataset publishes in degrees; read as a tangent plane, they lie 8 m off (the meridian
  convergence is 1.06 degrees). Later releases give metres from the start of the first sequence: a local metric frame.
- Velocities and angles refer to the same axes as the positions: to grid north, not to true north.
- ``roll, pitch, heading`` (radians) give ``grid_R_camera = X(-roll) Y(-pitch) Z(-heading)``, where X, Y and Z are
  right-handed rotations about the axes. The camera has x right, y down, z forward: the direction of travel is z within
  2 degrees, and up is -y.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64, Int64
from mirror.errors import RecordingError
from mirror.geometry.quaternions import quaternion_exp, quaternion_inverse, quaternion_multiply
from mirror.recordings.calibration import Calibration, Stage, make_calibration, to_calibration_table
from mirror.recordings.coordinates import FLU_FROM_CAMERA, track_from_utm
from mirror.recordings.on_road import OPTION, above_road_note, put_on_road
from mirror.recordings.opening import find_file, unreadable_error
from mirror.recordings.paths import list_folder
from mirror.recordings.protocol import CameraInfo, DriveInfo, FileStream, ImageStream, Recording, RigInfo, Track
from mirror.recordings.registry import refuse_options
from mirror.recordings.tabular import RecordingRows, read_rows

_NAME: Final = re.compile(r"boreas-\d{4}-\d{2}-\d{2}-\d{2}-\d{2}")
_POSES: Final = ("camera_poses.csv", "applanix/camera_poses.csv")
_UTM_ZONE: Final = 17
_REFERENCE_FRAME: Final = "boreas_enu_ref"
_CAMERA: Final = "front"
_RASTER_PX: Final = (2448, 2048)
_COLUMNS: Final = ("GPSTime", "easting", "northing", "altitude", "roll", "pitch", "heading")


class BoreasReader:
    """A reader of one sequence of Boreas."""

    name = "boreas"
    expects = "a folder boreas-YYYY-MM-DD-HH-MM with camera_poses.csv or applanix/camera_poses.csv"

    def recognises(self, path: Path) -> bool:
        """Return whether the folder has the name of a sequence and a pose file."""
        return _NAME.fullmatch(path.resolve().name) is not None and _pose_file(path) is not None

    def open(self, path: Path, options: Mapping[str, str]) -> Recording:
        """Open a sequence. The option ``height_m`` is the height of the camera above the road."""
        refuse_options(options, (OPTION,), path, self.name)
        poses = _pose_file(path)
        if poses is None:
            raise RecordingError("no pose file", file=path, expected=" or ".join(_POSES))
        return put_on_road(BoreasRecording(path, poses), options, path)


def _pose_file(path: Path) -> Path | None:
    return next((file for name in _POSES if (file := find_file(path, name))), None)


@dataclass(frozen=True)
class BoreasRecording:
    """A sequence: the camera's poses, and its images if they were downloaded."""

    path: Path
    poses: Path

    @cached_property
    def _rows(self) -> RecordingRows:
        types = {"GPSTime": pa.string(), **{name: pa.float64() for name in _COLUMNS[1:]}}
        return read_rows([self.poses], types=types, columns=_COLUMNS, tolerant=True)

    @property
    def _is_utm(self) -> bool:
        # The false easting keeps every UTM easting of Toronto above 600 km; the reference frame's extent is 10 km.
        return bool(np.nanmedian(np.abs(self._rows.floats("easting"))) > 1e5)

    @cached_property
    def info(self) -> DriveInfo:
        """The drive of a vehicle in Toronto, with the poses of the camera."""
        return DriveInfo(
            drive_id=self.path.resolve().name,
            vehicle_id="boreas",
            vehicle_type="boreas",
            time_base="Unix microseconds",
            frame=None if self._is_utm else _REFERENCE_FRAME,
            body_frame="camera",
            city="Toronto",
            licence="CC BY 4.0",
            notes=(above_road_note("camera"),),
        )

    @property
    def rig(self) -> RigInfo | None:
        """One camera; None if the sequence has no folder of images."""
        if not (self.path / "camera").is_dir():
            return None
        return RigInfo("boreas", (CameraInfo(_CAMERA, "camera"),), _CAMERA)

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the pose file, the camera's calibration and its images; lidar and radar are not read."""
        files = [self.poses, *self._image_files.values()]
        if self._projection is not None:
            files.append(self._projection)
        return sorted((file.relative_to(self.path).as_posix(), file) for file in files)

    def track(self) -> Track:
        """Return the camera's poses, rotated to x forward, y left, z up."""
        rows = self._rows
        stamps = rows.stamps("GPSTime", "unix_us")
        rotation = self._rotation()
        easting, northing, height = (rows.floats(name) for name in ("easting", "northing", "altitude"))
        if self._is_utm:
            track = track_from_utm(
                stamps,
                easting,
                northing,
                height,
                rotation,
                zone=_UTM_ZONE,
                north=True,
                faults=rows.faults,
                locate=rows.locate,
                file=self.poses,
            )
        else:
            track = Track(stamps, x_m=easting, y_m=northing, height_m=height, rotation=rotation, file=self.poses)
        return rows.without_bad(track)

    def _rotation(self) -> Float64:
        """(N, 4) ``grid_SE3_flu``: camera rotations with axes x forward, y left, z up."""
        rows = self._rows
        rotations = []
        for axis, name in enumerate(("roll", "pitch", "heading")):
            angle = rows.floats(name)
            bad = ~np.isfinite(angle)
            remedy = "remove the row from the pose file"
            rows.refuse(bad, name, "no angle", expected="radians", remedy=remedy, reason="rotation")
            rotations.append(quaternion_exp(np.outer(np.where(bad, 0.0, -angle), np.eye(3)[axis])))
        roll, pitch, heading = rotations
        grid_from_camera = quaternion_multiply(roll, quaternion_multiply(pitch, heading))
        return quaternion_multiply(grid_from_camera, quaternion_inverse(FLU_FROM_CAMERA))

    @property
    def _projection(self) -> Path | None:
        return find_file(self.path, "calib/P_camera.txt")

    def calibrations(self) -> pa.Table:
        """Return the rectified camera of ``calib/P_camera.txt``.

        The ego frame has the camera's origin and axes x forward, y left, z up, so the mounting is a rotation alone.
        """
        calibrations: list[tuple[Stage, Calibration]] = []
        file = self._projection
        if self.rig is not None and file is not None:
            try:
                projection = np.loadtxt(file)
            except (ValueError, OSError) as error:
                raise unreadable_error(file, error) from error
            if projection.shape not in ((3, 4), (4, 4)):
                raise RecordingError(
                    f"a matrix of shape {projection.shape}", file=file, expected="3 or 4 rows of 4 numbers"
                )
            calibration = make_calibration(
                file,
                _CAMERA,
                model="pinhole",
                width_px=_RASTER_PX[0],
                height_px=_RASTER_PX[1],
                fx_px=projection[0, 0],
                fy_px=projection[1, 1],
                # Boreas follows OpenCV: the centre of the first pixel is at 0.
                cx_px=projection[0, 2] + 0.5,
                cy_px=projection[1, 2] + 0.5,
                ego_SE3_camera=(*FLU_FROM_CAMERA.tolist(), 0.0, 0.0, 0.0),
                method="P_camera.txt of the rectified pictures",
            )
            calibrations.append(("factory", calibration))
        return to_calibration_table(calibrations, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    @cached_property
    def _image_files(self) -> dict[int, Path]:
        """Image files by their time in microseconds, ascending."""
        folder = self.path / "camera"
        if not folder.is_dir():
            return {}
        images = {}
        for name, file in list_folder(self.path, folder).items():
            stem, _, suffix = name.rpartition(".")
            if suffix != "png" or not stem.isdecimal():
                raise RecordingError("no image of the camera", file=file, expected="<microseconds>.png")
            images[int(stem)] = file
        return dict(sorted(images.items()))

    def images(self) -> Mapping[str, ImageStream]:
        """Return the camera's images; a file's name is taken as mid-exposure, as exposure lengths are not recorded."""
        if self.rig is None:
            return {}
        files = self._image_files
        stamps: Int64 = np.fromiter(files, np.int64, len(files)) * 1_000
        return {_CAMERA: FileStream(_CAMERA, "png", stamps, stamps, tuple(files.values()))}

    def boxes(self) -> None:
        """Return None: the sequences have no boxes."""
        return
