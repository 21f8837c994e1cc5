"""KITTI odometry: sequences of a station wagon in Karlsruhe, with rectified cameras and poses of the first camera.

Facts of the format, from the development kit of the benchmark:

- ``poses/NN.txt`` has a line for each frame: 12 numbers, ``world_SE3_camera`` of camera 0 as a 3x4 matrix by rows. The
  world is the camera at the first frame: x right, y down, z forward. Sequences 11 to 21 have no published poses.
- ``sequences/NN/times.txt`` has a line for each frame: seconds since the first one.
- ``sequences/NN/calib.txt`` holds the projections ``P0`` to ``P3`` (3x4) of the rectified cameras from the frame of
  camera 0, and ``Tr``, the pose of the lidar. It does not state the size of the images. Principal points have the
  centre of the first pixel at 0.
- ``sequences/NN/image_C/FFFFFF.png``: cameras 0 and 1 are grey, 2 and 3 colour.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Int64
from mirror.errors import RecordingError
from mirror.geometry.poses import Poses, to_pose_numbers
from mirror.geometry.quaternions import quaternion_inverse, quaternion_multiply, rotate
from mirror.recordings.calibration import Calibration, Stage, make_calibration, to_calibration_table
from mirror.recordings.coordinates import FLU_FROM_CAMERA, to_ego_track
from mirror.recordings.on_road import above_road
from mirror.recordings.opening import find_file, read_file_start, require_file
from mirror.recordings.paths import to_identifier
from mirror.recordings.protocol import CameraInfo, DriveInfo, ImageStream, RigInfo, Track
from mirror.recordings.raster import read_raster_size
from mirror.recordings.readers.collection import choose_drive
from mirror.recordings.readers.kitti_files import (
    CAMERA_HEIGHT_M,
    NO_STAMP,
    camera_centre,
    list_numbered_files,
    read_named_values,
    read_number_rows,
    to_frame_stream,
    to_numbers,
)
from mirror.recordings.readers.stored_poses import REMEDY, mark_matrices
from mirror.recordings.registry import refuse_options
from mirror.recordings.row_faults import RowFaults
from mirror.recordings.time import ns_from_seconds

CAMERAS: Final = ("image_0", "image_1", "image_2", "image_3")
"""Folders of the images: two grey cameras, two colour cameras."""

_SEQUENCES: Final = "sequences"
_POSES: Final = "poses"
_SUFFIXES: Final = ("png", "jpg")
_DIGITS: Final = 6
_HEADER_BYTES: Final = 2**16
# A day: beyond it a number is no time within a sequence.
_LONGEST_S: Final = 86_400.0
_NO_POSES: Final = "name a sequence with poses (00 to 10), put its poses there, or find them with `mirror poses`"


class KittiOdometryReader:
    """A reader of the sequences of a KITTI odometry folder; paths are ``FOLDER/NN`` or ``FOLDER/sequences/NN``."""

    name = "kitti_odometry"
    expects = f"a KITTI odometry folder with {_SEQUENCES}/NN/times.txt and {_POSES}/NN.txt, or FOLDER/NN"

    def recognises(self, path: Path) -> bool:
        """Return whether the folder holds sequences or is a sequence."""
        return _is_root(path) or _is_sequence(path)

    def drives(self, path: Path) -> Sequence[str]:
        """Return the names of the sequences that have poses; the names of all sequences if none has poses."""
        if not _is_root(path):
            return [path.name]
        names = _sequences(path)
        return [name for name in names if find_file(path, f"{_POSES}/{name}.txt")] or names

    def open(self, path: Path, options: Mapping[str, str]) -> KittiOdometryRecording:
        """Open a sequence; there are no options."""
        refuse_options(options, (), path, self.name)
        root, name = (path, None) if _is_root(path) else (path.parent, path.name)
        if _is_sequence(path):
            root = path.parent.parent
        if not _is_root(root):
            raise RecordingError("no KITTI odometry folder", file=path, expected=self.expects)
        return KittiOdometryRecording(
            root, choose_drive(self.drives(root) if name is None else _sequences(root), name, root)
        )


def _is_root(path: Path) -> bool:
    return (path / _SEQUENCES).is_dir() and any(_is_sequence(child) for child in (path / _SEQUENCES).iterdir())


def _is_sequence(path: Path) -> bool:
    # By names alone: what a pipe or a broken link in their place is, the error of the file says when it is read.
    return path.parent.name == _SEQUENCES and all(os.path.lexists(path / name) for name in ("times.txt", "calib.txt"))


def _sequences(root: Path) -> list[str]:
    return sorted(child.name for child in (root / _SEQUENCES).iterdir() if _is_sequence(child))


@dataclass(frozen=True)
class KittiOdometryRecording:
    """One sequence.

    Attributes:
        root: the folder of the data set.
        sequence: the sequence's name.
    """

    root: Path
    sequence: str

    @property
    def _folder(self) -> str:
        return f"{_SEQUENCES}/{self.sequence}"

    @cached_property
    def info(self) -> DriveInfo:
        """The drive, in the world of its first camera; all sequences have the same vehicle."""
        drive = to_identifier(f"kitti_odometry_{self.sequence}")
        return DriveInfo(
            drive_id=drive,
            vehicle_id="kitti",
            vehicle_type="station wagon",
            time_base="seconds since the first frame",
            frame=drive,
            body_frame="camera",
            city="Karlsruhe",
            licence="CC BY-NC-SA 3.0",
            has_date=False,
            has_poses=find_file(self.root, f"{_POSES}/{self.sequence}.txt") is not None,
        )

    @cached_property
    def _stamps(self) -> tuple[Path, Int64]:
        """The stamp of each frame; `NO_STAMP` where a line is none."""
        file = require_file(self.root, f"{self._folder}/times.txt")
        rows = read_number_rows(file, 1, "seconds since the first frame")
        seconds = np.full(int(rows.line.max(initial=0)), np.nan)
        seconds[rows.line - 1] = rows.values[:, 0]
        known = np.abs(seconds) < _LONGEST_S
        return file, np.where(known, ns_from_seconds(np.where(known, seconds, 0.0)), NO_STAMP)

    @cached_property
    def _files(self) -> dict[str, dict[int, Path]]:
        """Images by camera and frame."""
        found = {}
        for camera in CAMERAS:
            folder = self.root / self._folder / camera
            if files := list_numbered_files(self.root, folder, _DIGITS, _SUFFIXES):
                found[camera] = files
        return found

    @cached_property
    def rig(self) -> RigInfo | None:
        """The cameras that have images."""
        cameras = tuple(CameraInfo(camera, camera) for camera in self._files)
        if not cameras:
            return None
        return RigInfo("_".join(("kitti_odometry", *self._files)), cameras, cameras[0].name)

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the poses, times, calibration and images of the sequence."""
        names = (f"{_POSES}/{self.sequence}.txt", f"{self._folder}/calib.txt", f"{self._folder}/times.txt")
        files = [(name, file) for name in names if (file := find_file(self.root, name)) is not None]
        images = [file for by_frame in self._files.values() for file in by_frame.values()]
        return sorted([*files, *((file.relative_to(self.root).as_posix(), file) for file in images)])

    def track(self) -> Track:
        """Return the poses of the point on the road below camera 0; axes x forward, y left, z up, as the world's."""
        file = find_file(self.root, f"{_POSES}/{self.sequence}.txt")
        if file is None:
            raise RecordingError(
                "the sequence has no poses",
                file=self.root / _POSES / f"{self.sequence}.txt",
                expected="the file of its poses",
                remedy=_NO_POSES,
            )
        rows = read_number_rows(file, 12, "a 3x4 matrix")
        times, by_frame = self._stamps
        lines = len(rows.line) + len(rows.torn)
        if lines != len(by_frame):
            raise RecordingError(
                f"{lines} poses for {len(by_frame)} frames",
                file=file,
                expected=f"a line for each line of {times.relative_to(self.root)}",
                remedy=REMEDY,
            )
        matrix = rows.values.reshape(-1, 3, 4)
        stamps = by_frame[rows.line - 1]
        faults = RowFaults(len(matrix), rows.torn)

        def no_time(row: int) -> RecordingError:
            place = f"line {rows.line[row]}"
            return RecordingError("no time", file=times, place=place, expected="seconds", remedy=REMEDY)

        def no_motion(row: int) -> RecordingError:
            return RecordingError(
                f"the matrix {matrix[row].tolist()}",
                file=file,
                place=f"line {rows.line[row]}",
                expected="a rigid 3x4 matrix",
                remedy=REMEDY,
            )

        faults.add(stamps == NO_STAMP, "time", no_time)
        poses, bad = mark_matrices(matrix)
        faults.add(bad, "rotation", no_motion)
        turned = quaternion_multiply(FLU_FROM_CAMERA[None], poses.rotation)
        position = rotate(FLU_FROM_CAMERA[None], poses.translation)
        camera = faults.drop_from(
            Track(
                np.where(stamps == NO_STAMP, 0, stamps),
                x_m=position[:, 0],
                y_m=position[:, 1],
                height_m=position[:, 2],
                rotation=quaternion_multiply(turned, quaternion_inverse(FLU_FROM_CAMERA)[None]),
                file=file,
            )
        )
        return replace(to_ego_track(camera, above_road(CAMERA_HEIGHT_M)), bad=camera.bad)

    def calibrations(self) -> pa.Table:
        """Return the cameras that have images, with the size in the header of their first image."""
        file = require_file(self.root, f"{self._folder}/calib.txt")
        lines = read_named_values(file)
        calibrations: list[tuple[Stage, Calibration]] = []
        for camera, files in self._files.items():
            name = f"P{camera[-1]}"
            projection = to_numbers(lines, name, (3, 4), file)
            beside = Poses(
                FLU_FROM_CAMERA[None], rotate(FLU_FROM_CAMERA[None], camera_centre(projection, name, file)[None])
            )
            image = next(iter(files.values()))
            width, height = read_raster_size(read_file_start(image, _HEADER_BYTES)[0], image)
            calibration = make_calibration(
                file,
                camera,
                model="pinhole",
                width_px=width,
                height_px=height,
                fx_px=projection[0, 0],
                fy_px=projection[1, 1],
                cx_px=projection[0, 2] + 0.5,
                cy_px=projection[1, 2] + 0.5,
                ego_SE3_camera=to_pose_numbers(above_road(CAMERA_HEIGHT_M) @ beside),
                method="KITTI calib.txt, images rectified",
            )
            calibrations.append(("factory", calibration))
        return to_calibration_table(calibrations, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def images(self) -> Mapping[str, ImageStream]:
        """Return the images at the times of their frames, which are the same for all cameras."""
        if not self._files:
            return {}
        place, by_frame = self._stamps
        return {
            camera: to_frame_stream(camera, files, by_frame, place, REMEDY) for camera, files in self._files.items()
        }

    def boxes(self) -> None:
        """Return None: the sequences have no boxes."""
        return
