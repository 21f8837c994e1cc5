"""Lenses of NCore as lenses of MIRROR; both have the corner of the image at (0, 0).

Source: the sensor models that NCore publishes (docs/data/sensor_models). An ``ftheta`` lens images the angle theta at
the radius of a polynomial, multiplied by the matrix ``[[c, d], [e, 1]]``; one of its two polynomials is the reference,
the other its approximate inverse, and its principal point counts from the centre of the first pixel.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64
from mirror.errors import RecordingError
from mirror.geometry.cameras.camera import Camera
from mirror.recordings.readers.f_theta_fit import fit_f_theta, sample_directions

SHUTTERS: Final = {
    "ROLLING_TOP_TO_BOTTOM": "top_to_bottom",
    "ROLLING_LEFT_TO_RIGHT": "left_to_right",
    "ROLLING_BOTTOM_TO_TOP": "bottom_to_top",
    "ROLLING_RIGHT_TO_LEFT": "right_to_left",
    "GLOBAL": "global",
}
_MODELS: Final = "ideal-pinhole, opencv-pinhole without thin prism, opencv-fisheye or ftheta, without a windshield"
_LARGEST_PX: Final = 1.0
_INVERSE_SAMPLES: Final = 4096


def to_camera(lens: Any, file: Path, camera: str) -> tuple[Camera, str]:
    """Convert the parameters of a lens.

    Args:
        lens: ``CameraModelParameters`` of NCore.
        file: the store, for messages.
        camera: the camera's name, for messages.

    Returns:
        The lens, and what was converted, for the column ``method``.

    Raises:
        RecordingError: MIRROR has no such lens.
    """
    kind = lens.type()
    width, height = (int(value) for value in lens.resolution)
    if lens.external_distortion_parameters is not None:
        raise _unknown_lens(f"the lens {kind} lies behind a windshield", file, camera)
    if kind == "ftheta":
        return _f_theta(lens, width, height, file, camera)
    if kind not in ("ideal-pinhole", "opencv-pinhole", "opencv-fisheye"):
        raise _unknown_lens(f"the lens {kind!r:.80}", file, camera)
    fx, fy, cx, cy = (float(value) for value in (*lens.focal_length, *lens.principal_point))

    def make(model: str, distortion: tuple[float, ...] = ()) -> tuple[Camera, str]:
        return Camera(model, width, height, fx, fy, cx, cy, distortion), kind

    if kind == "ideal-pinhole":
        return make("pinhole")
    radial = tuple(float(value) for value in lens.radial_coeffs)
    if kind == "opencv-fisheye":
        return make("kannala_brandt", radial)
    if np.any(lens.thin_prism_coeffs):
        raise _unknown_lens(f"thin prism {lens.thin_prism_coeffs.tolist()}", file, camera)
    tangential = tuple(float(value) for value in lens.tangential_coeffs)
    if any(radial[3:]):
        return make("rational", (*radial[:2], *tangential, *radial[2:]))
    if any(radial) or any(tangential):
        return make("brown_conrady", (*radial[:2], *tangential, radial[2]))
    return make("pinhole")


def _f_theta(lens: Any, width: int, height: int, file: Path, camera: str) -> tuple[Camera, str]:
    c, d, e = (float(value) for value in lens.linear_cde)
    centre = np.asarray(lens.principal_point, np.float64) + 0.5
    forward = np.asarray(lens.angle_to_pixeldist_poly, np.float64)
    exact = lens.reference_poly.name == "ANGLE_TO_PIXELDIST"
    if exact and d == 0.0 and e == 0.0 and forward[0] == 0.0:
        distortion = tuple(np.trim_zeros(forward, "b").tolist())
        return Camera("f_theta", width, height, c, 1.0, float(centre[0]), float(centre[1]), distortion), lens.type()
    angle = float(lens.max_angle)
    if not 0.0 < angle <= np.pi or not 0.0 < c < np.inf:
        raise _unknown_lens(f"an f-theta lens up to {angle:g} rad, with c = {c:g}", file, camera)
    directions = sample_directions(angle)
    across = np.hypot(directions[:, 0], directions[:, 1])
    theta = np.arctan2(across, directions[:, 2])
    backward = np.asarray(lens.pixeldist_to_angle_poly, np.float64)
    radius = np.polynomial.polynomial.polyval(theta, forward) if exact else _invert(backward, theta, width, height)
    sensor = directions[:, :2] / across[:, None] * radius[:, None]
    uv = sensor @ np.array([[c, d], [e, 1.0]]).T + centre
    fit = fit_f_theta(directions, uv, width_px=width, height_px=height, aspect=1.0 / c)
    if not fit.largest_px <= _LARGEST_PX:
        raise _unknown_lens(f"an f-theta lens that a radial polynomial misses by {fit.largest_px:.2g} px", file, camera)
    return fit.camera, f"{lens.type()}, {fit.note}"


def _invert(polynomial: Float64, theta: Float64, width: int, height: int) -> Float64:
    """Radii at which a polynomial of the radius has these values; NaN beyond where it grows."""
    radius = np.linspace(0.0, float(np.hypot(width, height)), _INVERSE_SAMPLES)
    value = np.polynomial.polynomial.polyval(radius, polynomial)
    falling = np.flatnonzero(np.diff(value) <= 0.0)
    end = int(falling[0]) + 1 if len(falling) else len(radius)
    found = np.interp(theta, value[:end], radius[:end], left=np.nan, right=np.nan)
    slope = np.polynomial.polynomial.polyder(polynomial)
    for _ in range(3):
        excess = np.polynomial.polynomial.polyval(found, polynomial) - theta
        found = found - excess / np.polynomial.polynomial.polyval(found, slope)
    return found


def _unknown_lens(problem: str, file: Path, camera: str) -> RecordingError:
    return RecordingError(
        f"{problem}: MIRROR has no such lens",
        file=file,
        place=f"camera {camera}",
        expected=_MODELS,
        remedy="read the other cameras alone: --option cameras=NAME,NAME",
    )
