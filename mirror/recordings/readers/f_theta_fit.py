"""Converts lenses for which MIRROR has no model to the nearest ``f_theta`` lens, and says how near it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.geometry.cameras.camera import Camera

# Beyond this degree the residual of a lens is not radial, and higher powers change nothing.
_DEGREE: Final = 8


@dataclass(frozen=True)
class FThetaFit:
    """An ``f_theta`` lens and its distance from the lens that it replaces.

    Attributes:
        camera: the lens.
        largest_px: the largest distance of its pixels from those of the other lens.
        rms_px: root of the mean square of the distances.
    """

    camera: Camera
    largest_px: float
    rms_px: float

    @property
    def note(self) -> str:
        """The distance in words, for the column ``method`` of a calibration."""
        return f"as f_theta within {self.largest_px:.2g} px (rms {self.rms_px:.2g} px)"


def sample_directions(largest_angle_rad: float, angles: int = 96, turns: int = 48) -> Float64:
    """Return unit vectors (N, 3) on circles around z, up to an angle from z."""
    angle = np.linspace(largest_angle_rad / angles, largest_angle_rad, angles)[:, None]
    turn = np.linspace(0.0, 2.0 * np.pi, turns, endpoint=False)
    across = np.sin(angle)
    return np.stack([across * np.cos(turn), across * np.sin(turn), np.cos(angle) + 0.0 * turn], axis=-1).reshape(-1, 3)


def fit_f_theta(
    directions: Float64, uv_px: Float64, *, width_px: int, height_px: int, aspect: float = 1.0, degree: int = _DEGREE
) -> FThetaFit:
    """Fit principal point and polynomial by linear least squares.

    Args:
        directions: (N, 3) unit vectors in the camera frame.
        uv_px: (N, 2) their pixels; the corner of the image is at (0, 0). Only those on the raster count.
        width_px: of the raster.
        height_px: of the raster.
        aspect: focal length along y divided by that along x.
        degree: of the polynomial.

    Raises:
        UsageError: the fitted numbers make no camera: the pixels are those of no lens.
    """
    inside = np.isfinite(uv_px).all(axis=1)
    inside &= ((uv_px >= 0.0) & (uv_px < (width_px, height_px))).all(axis=1)
    x, y, z = directions[inside].T
    uv = uv_px[inside]
    across = np.hypot(x, y)
    angle = np.arctan2(across, z)
    # Scaled powers keep the normal equations well conditioned.
    largest = float(angle.max(initial=0.0)) or 1.0
    powers = (angle / largest)[:, None] ** np.arange(1, degree + 1)
    unit = np.stack([x, y], axis=1) / np.where(across == 0.0, 1.0, across)[:, None]
    count = len(uv)
    matrix = np.zeros((2 * count, degree + 2))
    matrix[:count, 0] = matrix[count:, 1] = 1.0
    matrix[:count, 2:], matrix[count:, 2:] = powers * unit[:, :1], powers * unit[:, 1:] * aspect
    solved = np.linalg.lstsq(matrix, uv.T.ravel(), rcond=None)[0] if count else np.zeros(degree + 2)
    coefficients = solved[2:] / largest ** np.arange(1, degree + 1)
    distortion = (0.0, *coefficients.tolist())
    camera = Camera("f_theta", width_px, height_px, 1.0, aspect, float(solved[0]), float(solved[1]), distortion)
    distance = np.linalg.norm(camera.project(directions[inside]).uv_px - uv, axis=1)
    return FThetaFit(camera, float(distance.max()), float(np.sqrt(np.mean(distance**2))))
