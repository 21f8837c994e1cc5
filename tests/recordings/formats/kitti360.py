"""Writes drives as a KITTI-360 folder: poses, stamps, calibrations and rectified images of two cameras."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import matrix_from_quaternion, quaternion_exp
from tests.recordings.formats.street import StreetDrive

CAMERAS = {"front_wide": "image_00", "front_narrow": "image_01"}
# The IMU's axes, y right and z down, in the ego's.
_EGO_FROM_IMU = np.diag([1.0, -1.0, -1.0, 1.0])
# What rectification turns a camera by.
TURN = quaternion_exp([[0.01, -0.02, 0.005]])


def write_kitti360(root: Path, drives: Sequence[StreetDrive]) -> Path:
    """Write the drives, and return the folder. The world is the dataset's; an image's frame is its index.

    Poses are those at the stamps of the first camera, which is also the second camera's.
    """
    (root / "calibration").mkdir(parents=True)
    for drive in drives:
        names = [name for name in CAMERAS if name in drive.cameras]
        stamps = drive.image_ns[names[0]]
        poses = root / "data_poses" / drive.name
        poses.mkdir(parents=True)
        matrix = _matrices(drive.poses_at(stamps)) @ _EGO_FROM_IMU
        rows = [f"{frame} {' '.join(f'{v:.12g}' for v in values[:3].ravel())}" for frame, values in enumerate(matrix)]
        (poses / "poses.txt").write_text("\n".join(rows) + "\n")
        for name in names:
            folder = root / "data_2d_raw" / drive.name / CAMERAS[name]
            (folder / "data_rect").mkdir(parents=True)
            text = [str(stamp.astype("datetime64[ns]")).replace("T", " ") for stamp in stamps]
            (folder / "timestamps.txt").write_text("\n".join(text) + "\n")
            for index in range(len(stamps)):
                (folder / "data_rect" / f"{index:010d}.png").write_bytes(drive.image(name, index, ".png"))
    names = [name for name in CAMERAS if name in drives[0].cameras]
    lenses, mountings = [], []
    turn = matrix_from_quaternion(TURN)[0]
    for name in names:
        lens, digits = drives[0].cameras[name], CAMERAS[name][-2:]
        unrectified = np.eye(4)
        unrectified[:3, :3] = turn
        imu_from_camera = _EGO_FROM_IMU @ _matrices(drives[0].ego_SE3_camera[name])[0] @ unrectified
        mountings.append(f"{CAMERAS[name]}: {_join(imu_from_camera[:3])}")
        projection = np.zeros((3, 4))
        projection[:, :3] = lens.intrinsic_matrix(first_pixel_centre=0.0)
        projection[0, 3] = -328.0 if digits == "01" else 0.0
        lenses += [
            f"S_rect_{digits}: {lens.width_px} {lens.height_px}",
            f"R_rect_{digits}: {_join(turn)}",
            f"P_rect_{digits}: {_join(projection)}",
        ]
    (root / "calibration" / "perspective.txt").write_text("calib_time: 2013\n" + "\n".join(lenses) + "\n")
    (root / "calibration" / "calib_cam_to_pose.txt").write_text("\n".join(mountings) + "\n")
    return root


def _join(values: np.ndarray) -> str:
    return " ".join(f"{value:.15g}" for value in values.ravel())


def _matrices(poses: Poses) -> np.ndarray:
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = matrix_from_quaternion(poses.rotation), poses.translation
    return out
