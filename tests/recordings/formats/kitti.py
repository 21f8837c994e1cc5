"""Writes drives as KITTI: the odometry benchmark's folder, with poses of its first camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import matrix_from_quaternion
from tests.recordings.formats.street import StreetDrive

# Places of the cameras in the frame of the first, in metres: two grey cameras, two colour cameras.
CENTRES_M = ((0.0, 0.0, 0.0), (0.537, 0.0, 0.0), (-0.06, 0.0003, -0.0027), (0.473, -0.0011, -0.0019))
# x forward, y left, z up in the axes of a camera.
_CAMERA_FROM_FLU = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def rectified(drive: StreetDrive, names: tuple[str, ...]) -> StreetDrive:
    """The drive with cameras beside its front camera, which take their images together; each has a lens of its own."""
    lens, mounting = drive.cameras["front_wide"], drive.ego_SE3_camera["front_wide"]
    here = np.array([[1.0, 0.0, 0.0, 0.0]])
    return replace(
        drive,
        cameras={name: replace(lens, fx_px=lens.fx_px + n, cx_px=lens.cx_px - n) for n, name in enumerate(names)},
        ego_SE3_camera={name: mounting @ Poses(here, np.array([c])) for name, c in zip(names, CENTRES_M)},
        image_ns=dict.fromkeys(names, drive.image_ns["front_wide"]),
    )


def from_first_camera(drive: StreetDrive, cameras: int = 4) -> StreetDrive:
    """The drive as the odometry benchmark has it: its body is the first camera, its world that of the first frame.

    Stamps begin at 0, there is a pose for each frame, and there are no boxes. Body and world are x forward, y left, z
    up.
    """
    drive = rectified(drive, tuple(f"image_{number}" for number in range(cameras)))
    stamps = drive.image_ns["image_0"]
    body = drive.ego_SE3_camera["image_0"] @ Poses.from_matrix(_CAMERA_FROM_FLU[None])
    first = (drive.poses_at(stamps[:1]) @ body).inverse()
    return replace(
        drive,
        pose_ns=stamps - stamps[0],
        poses_at=lambda relative: first @ drive.poses_at(np.asarray(relative) + stamps[0]) @ body,
        ego_SE3_camera={name: body.inverse() @ pose for name, pose in drive.ego_SE3_camera.items()},
        image_ns=dict.fromkeys(drive.image_ns, stamps - stamps[0]),
        box_ns=stamps[:0],
        objects=(),
    )


def write_kitti_odometry(root: Path, sequences: Mapping[str, StreetDrive], suffix: str = ".png") -> Path:
    """Write drives of `from_first_camera` by the names of their sequences, and return the folder."""
    (root / "poses").mkdir(parents=True)
    for name, drive in sequences.items():
        folder = root / "sequences" / name
        folder.mkdir(parents=True)
        stamps = drive.pose_ns
        matrix = _CAMERA_FROM_FLU @ matrices(drive.poses_at(stamps)) @ _CAMERA_FROM_FLU.T
        (root / "poses" / f"{name}.txt").write_text("\n".join(join(one[:3]) for one in matrix) + "\n")
        (folder / "times.txt").write_text("\n".join(f"{stamp * 1e-9:.9e}" for stamp in stamps) + "\n")
        lines = [f"P{n}: {join(projection(drive, f'image_{n}', CENTRES_M[n]))}" for n in range(len(drive.cameras))]
        (folder / "calib.txt").write_text("\n".join([*lines, f"Tr: {join(np.eye(4)[:3])}"]) + "\n")
        for camera in drive.cameras:
            (folder / camera).mkdir()
            for index in range(len(stamps)):
                (folder / camera / f"{index:06d}{suffix}").write_bytes(drive.image(camera, index, suffix))
    return root


def projection(drive: StreetDrive, camera: str, centre_m: tuple[float, float, float]) -> np.ndarray:
    """(3, 4) from the frame of the first camera to pixels, whose first has its centre at 0."""
    matrix = drive.cameras[camera].intrinsic_matrix(first_pixel_centre=0.0)
    return matrix @ np.column_stack([np.eye(3), -np.array(centre_m)])


def join(values: np.ndarray) -> str:
    """Numbers of a line, by rows."""
    return " ".join(f"{value:.15e}" for value in values.ravel())


def matrices(poses: Poses) -> np.ndarray:
    """(N, 4, 4)."""
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = matrix_from_quaternion(poses.rotation), poses.translation
    return out
