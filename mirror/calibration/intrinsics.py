"""A camera's lens from images of a calibration board, with its uncertainty and what the images say about it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from mirror.arrays import Float64, UInt8
from mirror.calibration.boards import BoardView, CalibrationBoard, board_normal, find_board, find_size
from mirror.errors import UsageError
from mirror.geometry.cameras import COEFFICIENTS, Camera

LensModel = Literal["brown_conrady", "rational", "kannala_brandt"]
FEWEST_IMAGES: Final = 3
ENOUGH_IMAGES: Final = 10
_SMALLEST_SPREAD_DEG: Final = 10.0
_LARGEST_SIGMA: Final = 0.02
_GRID: Final = (8, 6)
_SPARSE_SHARE: Final = 0.6
_SIZED_IMAGES: Final = 5
_OUTLIER: Final = 3.0


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """A lens, and how well the images determine the lens.

    Attributes:
        camera: the lens.
        parameters: names of the parameters that were estimated, in the order of `covariance`.
        covariance: (P, P) of these parameters, from the residuals; pixels for focal lengths and principal point.
        rms_px: root mean square distance of the corners from their projections.
        image_rms_px: the same for each image that was used, by name.
        rejected: why each of the other images was not used, by name.
        covered: share of the cells of a grid of 8 x 6 over the image that hold a corner.
        reach: distance of the farthest corner from the centre of the image, as a part of half the diagonal.
        spread_deg: largest angle between the normals of two boards.
    """

    camera: Camera
    parameters: tuple[str, ...]
    covariance: Float64
    rms_px: float
    image_rms_px: dict[str, float]
    rejected: dict[str, str]
    covered: float
    reach: float
    spread_deg: float

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviation of every parameter, by name."""
        return dict(zip(self.parameters, np.sqrt(np.diag(self.covariance)).tolist()))

    def doubts(self) -> list[str]:
        """Return reasons to doubt the lens, in words; empty if none was found."""
        found = []
        if len(self.image_rms_px) < ENOUGH_IMAGES:
            found.append(f"{len(self.image_rms_px)} images were used: {ENOUGH_IMAGES} to 30 determine a lens well")
        if self.covered < _SPARSE_SHARE or self.reach < _SPARSE_SHARE:
            found.append(
                f"corners cover {self.covered:.0%} of the image and reach {self.reach:.0%} of the way to its corners:"
                " the distortion beyond them is extrapolated; hold the board into the corners of the image too"
            )
        middle = float(np.median(list(self.image_rms_px.values())))
        wild = [name for name, rms in self.image_rms_px.items() if rms > max(_OUTLIER * middle, 1.0)]
        if wild:
            found.append(f"residuals far above the median {middle:.2f} px: {', '.join(wild)}; look at these images")
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain values, for JSON; the first pixel's centre is at 0.5 in the lens."""
        camera = self.camera
        return {
            "model": camera.model, "width_px": camera.width_px, "height_px": camera.height_px,
            "fx_px": camera.fx_px, "fy_px": camera.fy_px, "cx_px": camera.cx_px, "cy_px": camera.cy_px,
            "distortion": list(camera.distortion), "parameters": list(self.parameters), "sigma": self.sigma,
            "covariance": self.covariance.tolist(), "rms_px": self.rms_px, "image_rms_px": self.image_rms_px,
            "rejected": self.rejected, "covered": self.covered, "reach": self.reach, "spread_deg": self.spread_deg,
            "doubts": self.doubts(),
        }  # fmt: skip


def calibrate_intrinsics(
    images: Iterable[tuple[str, UInt8]], board: CalibrationBoard, model: LensModel = "brown_conrady"
) -> Intrinsics:
    """Estimate a lens (Z. Zhang, "A Flexible New Technique for Camera Calibration", 2000; OpenCV's adjustment).

    Args:
        images: names and (H, W) grey images; images of another size than most are left out.
        board: the board, which must lie flat.
        model: the lens; ``rational`` without the coefficients k5 and k6, which few images determine.

    Raises:
        UsageError: fewer than three images show the board, the board has another size, all boards have one
            orientation, or the images do not determine the focal length.
    """
    views: dict[str, BoardView] = {}
    sizes: dict[str, tuple[int, int]] = {}
    rejected: dict[str, str] = {}
    seen: list[tuple[int, int]] = []
    for name, image in images:
        found = find_board(image, board)
        if len(sizes) < _SIZED_IMAGES and board.kind == "chessboard" and (size := find_size(image)):
            seen.append(size)
        sizes[name] = (image.shape[1], image.shape[0])
        if isinstance(found, str):
            rejected[name] = found
        else:
            views[name] = found
    _require_size(board, seen)
    all_sizes = [sizes[name] for name in views]
    common = max(set(all_sizes), key=all_sizes.count) if all_sizes else (0, 0)
    for name in [name for name in views if sizes[name] != common]:
        rejected[name] = f"{sizes[name][0]} x {sizes[name][1]} px; most have {common[0]} x {common[1]}"
        del views[name]
    if len(views) < FEWEST_IMAGES:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in list(rejected.items())[:3])
        raise UsageError(
            f"{len(views)} of {len(sizes)} images show the board" + (f" ({reasons})" if reasons else ""),
            expected=f"at least {FEWEST_IMAGES} images with a board of {board.columns} x {board.rows} inner corners,"
            f" better {ENOUGH_IMAGES} or more",
            remedy="check --board (inner corners, not squares) and --kind, and take more images",
        )  # fmt: skip
    return _adjust(views, rejected, common, model)


def _require_size(board: CalibrationBoard, seen: Sequence[tuple[int, int]]) -> None:
    """Refuse a board of another size than the images show; a part of a board that leaves the image is smaller."""
    stated = (max(board.columns, board.rows), min(board.columns, board.rows))
    if not seen or stated in seen:
        return
    size = max(set(seen), key=lambda one: (seen.count(one), one))
    raise UsageError(
        f"the images show a board of {size[0]} x {size[1]} inner corners, not of {board.columns} x {board.rows}",
        place="--board",
        expected="the number of inner corners along each side, one less than the number of squares",
        remedy=f"--board {size[0]}x{size[1]}",
    )


def _adjust(
    views: dict[str, BoardView], rejected: dict[str, str], size: tuple[int, int], model: LensModel
) -> Intrinsics:
    import cv2

    # The fisheye functions of OpenCV 5 take points as one row.
    points = [view.points.reshape(1, -1, 3).astype(np.float64) for view in views.values()]
    pixels = [view.pixels.reshape(1, -1, 2).astype(np.float64) for view in views.values()]
    try:
        if model == "kannala_brandt":
            flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
            _, matrix, distortion, turns, shifts = cv2.fisheye.calibrate(
                points, pixels, size, np.zeros((3, 3)), np.zeros((4, 1)), flags=flags
            )
        else:
            flags = cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_FIX_K5 | cv2.CALIB_FIX_K6 if model == "rational" else 0
            _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
                [one.astype(np.float32) for one in points], [one.astype(np.float32) for one in pixels], size,
                np.zeros((3, 3)), np.zeros(8 if model == "rational" else 5), flags=flags,
            )  # fmt: skip
    except cv2.error as error:
        raise UsageError(
            f"OpenCV finds no lens ({error.err or error.func})",
            expected="sharp images of a flat board in several orientations",
            remedy="take more images, or another --model",
        ) from error
    names, residuals, covariance = _evaluate(points, pixels, matrix, distortion, turns, shifts, model)
    normals = np.array([board_normal(np.asarray(turn, np.float64)) for turn in turns])
    spread = float(np.rad2deg(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)).max()))
    relative = float(np.sqrt(max(covariance[0, 0], 0.0)) / abs(matrix[0, 0]))
    if not (spread >= _SMALLEST_SPREAD_DEG and relative <= _LARGEST_SIGMA):
        raise UsageError(
            f"the boards of {len(views)} images differ by at most {spread:.1f} degrees in orientation, which leaves the"
            f" focal length uncertain by {relative:.1%}",
            expected=f"boards that differ by {_SMALLEST_SPREAD_DEG:g} degrees or more, better 60",
            remedy="tilt the board about both of its axes, by 20 to 40 degrees to each side, and take more images",
        )  # fmt: skip
    count = len(COEFFICIENTS[model].split())
    # OpenCV's first pixel has its centre at 0, ours at 0.5.
    camera = Camera(
        model, *size, float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]) + 0.5, float(matrix[1, 2]) + 0.5,
        tuple(np.asarray(distortion, np.float64).ravel()[:count].tolist()),
    )  # fmt: skip
    every = np.concatenate([one.reshape(-1, 2) for one in pixels]) + 0.5
    cells = np.unique(np.floor(every / np.array(size) * np.array(_GRID)).astype(np.int64), axis=0)
    half = np.array(size) / 2.0
    return Intrinsics(
        camera=camera,
        parameters=names,
        covariance=covariance,
        rms_px=_rms(np.concatenate(residuals)),
        image_rms_px={name: _rms(one) for name, one in zip(views, residuals)},
        rejected=rejected,
        covered=len(cells) / (_GRID[0] * _GRID[1]),
        reach=float(np.linalg.norm(every - half, axis=1).max() / np.linalg.norm(half)),
        spread_deg=spread,
    )


def _rms(residuals: Float64) -> float:
    """Root mean square length of (N, 2) residuals."""
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))


def _evaluate(
    points: Sequence[Float64], pixels: Sequence[Float64], matrix: Any, distortion: Any, turns: Any, shifts: Any,
    model: LensModel,
) -> tuple[tuple[str, ...], list[Float64], Float64]:  # fmt: skip
    """Names of the lens's parameters, residuals (N, 2) of each image, and the covariance of the parameters.

    The poses of the boards are eliminated from the normal equations (Schur complement); the variance of a coordinate is
    the sum of squares over the degrees of freedom, as in OpenCV's ``calibrateCameraExtended``.
    """
    import cv2

    names = ("fx_px", "fy_px", "cx_px", "cy_px", *COEFFICIENTS[model].split())
    if model == "rational":
        names = names[:-2]
    reduced = np.zeros((len(names), len(names)))
    residuals = []
    for point, pixel, turn, shift in zip(points, pixels, turns, shifts):
        if model == "kannala_brandt":
            seen, jacobian = cv2.fisheye.projectPoints(point, turn, shift, matrix, distortion)
            lens, pose = jacobian[:, :8], jacobian[:, 8:14]
        else:
            seen, jacobian = cv2.projectPoints(point, turn, shift, matrix, distortion)
            lens, pose = jacobian[:, 6 : 6 + len(names)], jacobian[:, :6]
        residuals.append(pixel.reshape(-1, 2) - seen.reshape(-1, 2))
        mixed = lens.T @ pose
        reduced += lens.T @ lens - mixed @ np.linalg.pinv(pose.T @ pose) @ mixed.T
    squares = float(sum(np.sum(one**2) for one in residuals))
    freedom = sum(one.size for one in residuals) - len(names) - 6 * len(residuals)
    covariance = np.linalg.pinv((reduced + reduced.T) / 2.0, hermitian=True) * squares / max(freedom, 1)
    return names, residuals, np.asarray(covariance, np.float64)
