"""The cameras of KITTI raw from the three calibration files of a day.

``calib_imu_to_velo.txt`` holds ``lidar_SE3_receiver``, ``calib_velo_to_cam.txt`` ``camera0_SE3_lidar`` of camera 0
before rectification, both as ``R`` and ``T``. Of each camera ``NN``, ``calib_cam_to_cam.txt`` holds

- before rectification: size ``S``, matrix ``K``, distortion ``D`` (k1 k2 p1 p2 k3), ``R`` and ``T`` of
  ``cameraNN_SE3_camera0``;
- after it: size ``S_rect`` and projection ``P_rect`` (3x4) from the frame of the rectified camera 0, to which
  ``R_rect_00`` turns that of camera 0.

Principal points have the centre of the first pixel at 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.errors import RecordingError
from mirror.geometry.poses import Poses, to_pose_numbers
from mirror.recordings.calibration import Calibration, Stage, make_calibration
from mirror.recordings.on_road import above_road
from mirror.recordings.opening import find_file
from mirror.recordings.readers.kitti_files import (
    RECEIVER_HEIGHT_M,
    camera_centre,
    read_named_values,
    to_numbers,
)
from mirror.recordings.readers.stored_poses import is_no_rigid_motion, to_poses

CALIBRATION_FILES: Final = ("calib_cam_to_cam.txt", "calib_imu_to_velo.txt", "calib_velo_to_cam.txt")

Lines = Mapping[str, list[str]]


def read_calibrations(root: Path, cameras: Sequence[str], *, rectified: bool) -> list[tuple[Stage, Calibration]]:
    """Return the calibrations of cameras.

    Args:
        root: the folder of the day.
        cameras: names of the cameras, which end in their two digits.
        rectified: of rectified images, or of the images as the sensors took them.

    Raises:
        RecordingError: a file is missing, or a line of it, or a matrix is no rotation; it is named.
    """
    if not cameras:
        return []
    file = _require_file(root, "calib_cam_to_cam.txt")
    lines = read_named_values(file)
    mounted = read_lidar_pose(root) @ _read_motion(root, "calib_velo_to_cam.txt").inverse()
    place = _rectified if rectified else _distorted
    return [("factory", place(file, lines, camera, mounted)) for camera in cameras]


def read_lidar_pose(root: Path) -> Poses:
    """Return ``ego_SE3_lidar``; the ego has the axes of the receiver, and its origin on the road below it.

    Args:
        root: the folder of the day.

    Raises:
        RecordingError: the file is missing or broken.
    """
    return above_road(RECEIVER_HEIGHT_M) @ _read_motion(root, "calib_imu_to_velo.txt").inverse()


def _rectified(file: Path, lines: Lines, camera: str, ego_SE3_camera0: Poses) -> Calibration:
    digits = camera[-2:]
    projection = to_numbers(lines, f"P_rect_{digits}", (3, 4), file)
    width, height = to_numbers(lines, f"S_rect_{digits}", (2,), file)
    turn = _to_motion(to_numbers(lines, "R_rect_00", (3, 3), file), np.zeros(3), file, "R_rect_00")
    beside = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), camera_centre(projection, f"P_rect_{digits}", file)[None])
    return make_calibration(
        file,
        camera,
        model="pinhole",
        width_px=_whole(width),
        height_px=_whole(height),
        fx_px=projection[0, 0],
        fy_px=projection[1, 1],
        cx_px=projection[0, 2] + 0.5,
        cy_px=projection[1, 2] + 0.5,
        ego_SE3_camera=to_pose_numbers(ego_SE3_camera0 @ turn.inverse() @ beside),
        method="KITTI calib_cam_to_cam.txt, images rectified",
    )


def _distorted(file: Path, lines: Lines, camera: str, ego_SE3_camera0: Poses) -> Calibration:
    digits = camera[-2:]
    matrix = to_numbers(lines, f"K_{digits}", (3, 3), file)
    width, height = to_numbers(lines, f"S_{digits}", (2,), file)
    rotation, shift = (to_numbers(lines, f"{n}_{digits}", s, file) for n, s in (("R", (3, 3)), ("T", (3,))))
    camera_SE3_camera0 = _to_motion(rotation, shift, file, f"R_{digits}")
    return make_calibration(
        file,
        camera,
        model="brown_conrady",
        width_px=_whole(width),
        height_px=_whole(height),
        fx_px=matrix[0, 0],
        fy_px=matrix[1, 1],
        cx_px=matrix[0, 2] + 0.5,
        cy_px=matrix[1, 2] + 0.5,
        distortion=tuple(to_numbers(lines, f"D_{digits}", (5,), file).tolist()),
        ego_SE3_camera=to_pose_numbers(ego_SE3_camera0 @ camera_SE3_camera0.inverse()),
        method="KITTI calib_cam_to_cam.txt, images as the sensor took them",
    )


def _whole(value: float) -> int | float:
    """The number of pixels that a decimal number states; others are refused with the calibration."""
    return int(value) if value.is_integer() else float(value)


def _read_motion(root: Path, name: str) -> Poses:
    file = _require_file(root, name)
    lines = read_named_values(file)
    return _to_motion(to_numbers(lines, "R", (3, 3), file), to_numbers(lines, "T", (3,), file), file, "R")


def _to_motion(rotation: Float64, translation: Float64, file: Path, place: str) -> Poses:
    matrix = np.column_stack([rotation, translation])[None]
    if is_no_rigid_motion(matrix)[0]:
        raise RecordingError(
            f"no rigid motion: the rotation {rotation.tolist()}, the translation {translation.tolist()}",
            file=file,
            place=place,
            expected="a rotation and metres",
            remedy=_remedy(file.parent),
        )
    return to_poses(matrix)


def _require_file(root: Path, name: str) -> Path:
    file = find_file(root, name)
    if file is None:
        raise RecordingError("missing", file=root / name, expected="the calibration of the day", remedy=_remedy(root))
    return file


def _remedy(root: Path) -> str:
    return f"download {root.name}_calib.zip"
