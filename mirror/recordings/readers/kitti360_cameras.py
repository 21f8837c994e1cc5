"""The cameras of KITTI-360: two rectified ones, and two fisheyes whose lens becomes the nearest ``f_theta`` lens.

``calib_cam_to_pose.txt`` holds ``imu_SE3_camera``, for the rectified cameras before rectification; ``R_rect`` of
``perspective.txt`` turns it. Principal points have the centre of the first pixel at 0.

The fisheyes have Mei's model: a point is projected onto the unit sphere, from there through a point ``xi`` behind its
centre onto a plane, and distorted by ``k1 k2 p1 p2``. The dataset's own scripts leave ``p1 p2`` out, which moves pixels
by up to 1.1 px; here they count. Source: C. Mei, P. Rives, "Single view point omnidirectional camera calibration from
planar grids", ICRA 2007.
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
from mirror.recordings.coordinates import FLU_FROM_FRD
from mirror.recordings.opening import require_file
from mirror.recordings.readers.f_theta_fit import fit_f_theta, sample_directions
from mirror.recordings.readers.kitti_files import read_named_values, to_numbers

CAMERAS: Final = {"image_00": "data_rect", "image_01": "data_rect", "image_02": "data_rgb", "image_03": "data_rgb"}
"""Folders of the images by camera; the first two are rectified, the others fisheyes."""

CALIBRATION_FILES: Final = (
    "calibration/calib_cam_to_pose.txt",
    "calibration/image_02.yaml",
    "calibration/image_03.yaml",
    "calibration/perspective.txt",
)
# Beyond this angle the fisheyes image nothing: they see 185 degrees.
_LARGEST_ANGLE: Final = np.radians(98.0)
_LARGEST_PX: Final = 2.0
_MEI: Final = ("xi", "k1", "k2", "p1", "p2", "gamma1", "gamma2", "u0", "v0", "image_width", "image_height")


def read_calibrations(root: Path, cameras: Sequence[str]) -> list[tuple[Stage, Calibration]]:
    """Return the calibrations of cameras.

    Raises:
        RecordingError: a file is missing, or a line of it; or a lens is far from an ``f_theta`` lens.
    """
    if not cameras:
        return []
    file = require_file(root, "calibration/calib_cam_to_pose.txt")
    mountings = read_named_values(file)
    return [
        (
            "factory",
            (_rectified if folder == "data_rect" else _fisheye)(
                root, camera, to_numbers(mountings, camera, (3, 4), file)
            ),
        )
        for camera in cameras
        for folder in (CAMERAS[camera],)
    ]


def _rectified(root: Path, camera: str, mounting: Float64) -> Calibration:
    file = require_file(root, "calibration/perspective.txt")
    lenses, digits = read_named_values(file), camera[-2:]
    projection = to_numbers(lenses, f"P_rect_{digits}", (3, 4), file)
    width, height = to_numbers(lenses, f"S_rect_{digits}", (2,), file)
    turn = np.eye(4)
    turn[:3, :3] = to_numbers(lenses, f"R_rect_{digits}", (3, 3), file).T
    return make_calibration(
        file,
        camera,
        model="pinhole",
        width_px=int(width),
        height_px=int(height),
        fx_px=projection[0, 0],
        fy_px=projection[1, 1],
        cx_px=projection[0, 2] + 0.5,
        cy_px=projection[1, 2] + 0.5,
        ego_SE3_camera=_in_ego(mounting, turn),
        method="KITTI-360 perspective.txt, images rectified",
    )


def _fisheye(root: Path, camera: str, mounting: Float64) -> Calibration:
    file = require_file(root, f"calibration/{camera}.yaml")
    lines = read_named_values(file)
    numbers = {name: float(to_numbers(lines, name, (1,), file)[0]) for name in _MEI}
    width, height = int(numbers["image_width"]), int(numbers["image_height"])
    if not (0 < width < 2**15 and 0 < height < 2**15 and min(numbers["gamma1"], numbers["gamma2"]) > 0.0):
        raise RecordingError(
            f"a raster of {width} x {height} px, focal lengths {numbers['gamma1']:g} and {numbers['gamma2']:g}",
            file=file,
            expected="a lens of Mei's model",
            remedy="download the calibration again",
        )
    directions = sample_directions(_LARGEST_ANGLE)
    uv = mei_pixels(directions, numbers)
    fit = fit_f_theta(directions, uv, width_px=width, height_px=height, aspect=numbers["gamma2"] / numbers["gamma1"])
    if not fit.largest_px <= _LARGEST_PX:
        raise RecordingError(
            f"an f_theta lens misses this lens by {fit.largest_px:.2g} px",
            file=file,
            expected=f"at most {_LARGEST_PX:g} px, as for the fisheyes of KITTI-360",
            remedy="download the calibration again, or read the rectified cameras alone: --option fisheye=no",
        )
    lens = fit.camera
    return make_calibration(
        file,
        camera,
        **lens.to_row(),
        ego_SE3_camera=_in_ego(mounting, np.eye(4)),
        method=f"KITTI-360 {camera}.yaml, Mei's model {fit.note}",
    )


def mei_pixels(directions: Float64, numbers: Mapping[str, float]) -> Float64:
    """Project unit vectors (N, 3) to pixels (N, 2) by Mei's model; the image's corner is at (0, 0)."""
    with np.errstate(all="ignore"):
        x, y = (directions[:, :2] / (directions[:, 2:] + numbers["xi"])).T
        squared = x * x + y * y
        radial = 1.0 + numbers["k1"] * squared + numbers["k2"] * squared * squared
        p1, p2 = numbers["p1"], numbers["p2"]
        u = x * radial + 2.0 * p1 * x * y + p2 * (squared + 2.0 * x * x)
        v = y * radial + p1 * (squared + 2.0 * y * y) + 2.0 * p2 * x * y
        return np.stack(
            [numbers["gamma1"] * u + numbers["u0"] + 0.5, numbers["gamma2"] * v + numbers["v0"] + 0.5], axis=1
        )


def _in_ego(imu_SE3_camera: Float64, camera_SE3_rectified: Float64) -> tuple[float, ...]:
    """The mounting as seven numbers: the ego has the IMU's origin, with y left and z up."""
    matrix = np.concatenate([imu_SE3_camera, [[0.0, 0.0, 0.0, 1.0]]])
    flu = Poses(FLU_FROM_FRD[None], np.zeros((1, 3)))
    pose = flu @ Poses.from_matrix(matrix) @ Poses.from_matrix(camera_SE3_rectified)
    return to_pose_numbers(pose)
