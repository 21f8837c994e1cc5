"""Intrinsics from images of a chessboard, with the convention of `mirror.geometry.Camera`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from mirror.arrays import Float64, UInt8
from mirror.errors import UsageError
from mirror.geometry.cameras import COEFFICIENTS, Camera

Model = Literal["brown_conrady", "rational"]
_FEWEST: Final = 3


@dataclass(frozen=True, eq=False)
class ChessboardCalibration:
    """The intrinsics of one camera.

    Attributes:
        camera: the lens.
        rms_px: root mean square distance of the corners from their projections.
        sigma_px: standard deviations of fx, fy, cx, cy.
        used: numbers of the images with a complete board of the common size.
        rejected: why each of the other images was not used, by number.
    """

    camera: Camera
    rms_px: float
    sigma_px: Float64
    used: tuple[int, ...]
    rejected: dict[int, str]


def calibrate_chessboard(
    images: Sequence[UInt8], pattern: tuple[int, int], model: Model = "brown_conrady"
) -> ChessboardCalibration:
    """Estimate the intrinsics of a camera (Z. Zhang, "A Flexible New Technique for Camera Calibration", 2000; OpenCV).

    Args:
        images: (H, W) grey images; those of another size than most are left out.
        pattern: numbers of inner corners along the rows and the columns of the board.
        model: camera model; ``rational`` without the coefficients k5 and k6, which few images determine.

    Raises:
        UsageError: fewer than three images show the complete board.
    """
    import cv2

    sizes = [(image.shape[1], image.shape[0]) for image in images]
    common = max(set(sizes), key=sizes.count) if sizes else (0, 0)
    board = np.zeros((pattern[0] * pattern[1], 3), np.float32)
    board[:, :2] = np.mgrid[: pattern[0], : pattern[1]].T.reshape(-1, 2)
    done = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-3)
    corners, used, rejected = [], [], {}
    for number, image in enumerate(images):
        if sizes[number] != common:
            rejected[number] = f"{sizes[number][0]} x {sizes[number][1]} px; most have {common[0]} x {common[1]}"
            continue
        complete, found = cv2.findChessboardCorners(image, pattern)
        if not complete:
            rejected[number] = f"no complete board of {pattern[0]} x {pattern[1]} corners"
            continue
        corners.append(cv2.cornerSubPix(image, found, (7, 7), (-1, -1), done))
        used.append(number)
    if len(used) < _FEWEST:
        raise UsageError(
            f"{len(used)} of {len(images)} images show a complete board", expected=f"at least {_FEWEST}",
            remedy="check the pattern (inner corners, not squares), and take more images",
        )  # fmt: skip
    flags = cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_FIX_K5 | cv2.CALIB_FIX_K6 if model == "rational" else 0
    rms, matrix, distortion, _, _, sigma, _, _ = cv2.calibrateCameraExtended(
        [board] * len(corners),
        corners,
        common,
        None,
        None,
        flags=flags,  # type: ignore[call-overload]
    )
    fx, fy = float(matrix[0, 0]), float(matrix[1, 1])
    # OpenCV's first pixel has its centre at 0, ours at 0.5.
    cx, cy = float(matrix[0, 2]) + 0.5, float(matrix[1, 2]) + 0.5
    coefficients = tuple(distortion.ravel()[: len(COEFFICIENTS[model].split())].tolist())
    camera = Camera(model, common[0], common[1], fx, fy, cx, cy, coefficients)
    return ChessboardCalibration(camera, float(rms), np.asarray(sigma).ravel()[:4], tuple(used), rejected)
