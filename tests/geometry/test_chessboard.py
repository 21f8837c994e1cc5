"""Our camera models are OpenCV's: calibrate a real camera with OpenCV, reproject with ours."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest

from mirror.geometry import COEFFICIENTS, Camera, Poses, quaternion_exp

pytestmark = pytest.mark.real_data

PATTERN = (9, 6)


class Views(NamedTuple):
    size: tuple[int, int]
    board: np.ndarray
    corners: list[np.ndarray]


@pytest.fixture(scope="module")
def views(real_data: Path) -> Views:
    board = np.zeros((PATTERN[0] * PATTERN[1], 3), dtype=np.float32)
    board[:, :2] = np.mgrid[: PATTERN[0], : PATTERN[1]].T.reshape(-1, 2)
    found, sizes = [], []
    for path in sorted((real_data / "chessboard").glob("*.jpg")):
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        complete, corners = cv2.findChessboardCorners(grey, PATTERN)
        if complete:
            done = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-3)
            found.append(cv2.cornerSubPix(grey, corners, (7, 7), (-1, -1), done))
            sizes.append(grey.shape[::-1])
    size = max(set(sizes), key=sizes.count)
    return Views(size, board, [corners for corners, other in zip(found, sizes) if other == size])


def calibrate(views: Views, model: str, flags: int) -> tuple[float, Camera, np.ndarray]:
    """OpenCV's error and calibration, and the corners (views, corners, 3) in the camera frame."""
    rms, matrix, distortion, turns, shifts = cv2.calibrateCamera(
        [views.board] * len(views.corners), views.corners, views.size, None, None, flags=flags
    )
    camera = Camera(
        model,
        *views.size,
        fx_px=matrix[0, 0],
        fy_px=matrix[1, 1],
        cx_px=matrix[0, 2] + 0.5,
        cy_px=matrix[1, 2] + 0.5,
        distortion=tuple(distortion.ravel()[: len(COEFFICIENTS[model].split())]),
    )
    camera_SE3_board = Poses(quaternion_exp(np.array(turns)[..., 0]), np.array(shifts)[..., 0])
    return rms, camera, camera_SE3_board.transform(views.board)


def check_inverse(camera: Camera, points: np.ndarray) -> None:
    uv = camera.project(points).uv_px
    back = camera.unproject(uv)
    assert back.valid.all()
    assert np.abs(camera.project(back.direction).uv_px - uv).max() < 1e-9
    assert np.abs(back.direction - points / np.linalg.norm(points, axis=-1, keepdims=True)).max() < 1e-11


@pytest.mark.parametrize(
    ("model", "flags"),
    [
        ("brown_conrady", 0),
        ("rational", cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_FIX_K5 | cv2.CALIB_FIX_K6),
    ],
)
def test_reprojects_with_the_error_that_opencv_reports(views: Views, model: str, flags: int) -> None:
    assert len(views.corners) >= 8
    rms, camera, points = calibrate(views, model, flags)
    projection = camera.project(points)
    assert projection.valid.all()
    seen = np.array(views.corners).reshape(len(views.corners), -1, 2).astype(np.float64) + 0.5
    ours = np.sqrt(np.mean(np.sum((projection.uv_px - seen) ** 2, axis=-1)))
    assert rms < 1.5
    assert ours == pytest.approx(rms, abs=1e-6)
    check_inverse(camera, points)


def test_a_rational_fit_with_its_pole_in_the_image_is_found_out(views: Views) -> None:
    # All eight coefficients on so few views: numerator and denominator vanish at nearly one radius, inside the image.
    # OpenCV projects across the pole; a corner beyond it has a pixel by luck alone, and no ray of its own.
    _, camera, points = calibrate(views, "rational", cv2.CALIB_RATIONAL_MODEL)
    projection = camera.project(points)
    beyond = np.hypot(points[..., 0], points[..., 1]) / points[..., 2] >= np.tan(camera.angle_limit_rad)
    assert 0 < beyond.sum() < 0.05 * beyond.size
    assert (projection.defined == ~beyond).all()
    assert camera.rays().valid.mean() < 0.9
    theirs = cv2.projectPoints(
        points[~beyond],
        np.zeros(3),
        np.zeros(3),
        camera.intrinsic_matrix(first_pixel_centre=0.0),
        np.array(camera.distortion),
    )[0][:, 0]
    assert np.abs(projection.uv_px[~beyond] - (theirs + 0.5)).max() < 1e-9
    check_inverse(camera, points[~beyond])
