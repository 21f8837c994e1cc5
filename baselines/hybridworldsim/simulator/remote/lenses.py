"""Cameras as messages: f-theta polynomials, OpenCV's pinhole with distortion, and OpenCV's fisheye.

Principal points are those of images whose first pixel has its centre at (0.5, 0.5), as everywhere in MIRROR.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, Literal

import numpy as np

from hybridworldsim.simulator.remote.messages import wire
from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera
from mirror.geometry.rolling_shutter import ShutterDirection

Lens = Literal["own", "f_theta"]
FIT_PX: Final = 0.1
"""Greatest error of a fitted f-theta polynomial."""
_DEGREES: Final = (5, 7, 9, 11, 13, 15, 17, 19)
_SAMPLES: Final = 512
_SHUTTERS: Final[Mapping[ShutterDirection, str]] = {
    "global": "GLOBAL",
    "top_to_bottom": "ROLLING_TOP_TO_BOTTOM",
    "bottom_to_top": "ROLLING_BOTTOM_TO_TOP",
    "left_to_right": "ROLLING_LEFT_TO_RIGHT",
    "right_to_left": "ROLLING_RIGHT_TO_LEFT",
}
_RADIAL: Final = 6


def to_spec(camera: Camera, name: str, lens: Lens = "own", *, direction: ShutterDirection = "global") -> Any:
    """Return a camera as a ``CameraSpec``.

    Args:
        camera: the camera.
        name: the camera's name on the wire.
        lens: "own" for the message of the camera's model; "f_theta" for an f-theta polynomial in any case, which is
            fitted to at most `FIT_PX`: AlpaSim's rectification reads no other.
        direction: direction of the camera's shutter.

    Raises:
        UsageError: no f-theta polynomial fits.
    """
    messages = wire()
    spec = messages.CameraSpec(
        logical_id=name, resolution_h=camera.height_px, resolution_w=camera.width_px,
        shutter_type=messages.shutters[_SHUTTERS[direction]],
    )  # fmt: skip
    if lens == "f_theta" or camera.model == "f_theta":
        _fill_f_theta(spec.ftheta_param, camera)
    elif camera.model == "kannala_brandt":
        fisheye = spec.opencv_fisheye_param
        _fill_matrix(fisheye, camera)
        fisheye.radial_coeffs[:] = camera.distortion
        fisheye.max_angle = _image_angle(camera)
    else:
        pinhole = spec.opencv_pinhole_param
        _fill_matrix(pinhole, camera)
        k1, k2, p1, p2, *more = (*camera.distortion, *[0.0] * (8 - len(camera.distortion)))
        pinhole.radial_coeffs[:] = (k1, k2, *more)
        pinhole.tangential_coeffs[:] = (p1, p2)
        pinhole.thin_prism_coeffs[:] = (0.0,) * 4
    return spec


def from_spec(spec: Any) -> Camera:
    """Return the camera of a ``CameraSpec``.

    Raises:
        UsageError: the message holds no camera, or one with an effect that MIRROR's models do not have.
    """
    place = f"camera {spec.logical_id!r}"
    if spec.WhichOneof("external_distortion") is not None:
        raise UsageError("the camera looks through a windshield model", place=place, expected="a lens alone")
    kind = spec.WhichOneof("camera_param")
    width, height = spec.resolution_w, spec.resolution_h
    if kind is None:
        raise UsageError("the message has no lens", place=place, expected="f-theta, pinhole or fisheye parameters")
    lens = getattr(spec, kind)
    centre = lens.principal_point_x, lens.principal_point_y
    if kind == "ftheta_param":
        return _from_f_theta(lens, width, height, place)
    focal = lens.focal_length_x, lens.focal_length_y
    radial = tuple(lens.radial_coeffs)
    if kind == "opencv_fisheye_param":
        if len(radial) not in (0, 4):
            raise UsageError(f"{len(radial)} radial coefficients", place=place, expected="none, or 4")
        return Camera("kannala_brandt", width, height, *focal, *centre, radial or (0.0,) * 4)
    tangential = tuple(lens.tangential_coeffs)
    if any(lens.thin_prism_coeffs):
        raise UsageError("thin prism coefficients", place=place, expected="none, or zeros")
    if len(radial) > _RADIAL or len(tangential) not in (0, 2):
        raise UsageError(
            f"{len(radial)} radial and {len(tangential)} tangential coefficients", place=place, expected="at most 6, 2"
        )
    padded = (*radial, *[0.0] * (_RADIAL - len(radial)))
    numbers = *padded[:2], *(tangential or (0.0, 0.0)), *padded[2:]
    return Camera(
        "rational" if any(numbers) else "pinhole", width, height, *focal, *centre, numbers if any(numbers) else ()
    )


def direction_of(spec: Any) -> ShutterDirection:
    """Return the direction of the shutter of a ``CameraSpec``; a message without one has a global shutter."""
    numbers = wire().shutters
    return next((one for one, name in _SHUTTERS.items() if numbers[name] == spec.shutter_type), "global")


def _fill_matrix(lens: Any, camera: Camera) -> None:
    lens.principal_point_x, lens.principal_point_y = camera.cx_px, camera.cy_px
    lens.focal_length_x, lens.focal_length_y = camera.fx_px, camera.fy_px


def _image_angle(camera: Camera) -> float:
    """Angle from the axis of the farthest point of the image, or of the farthest that the model can image."""
    corners = np.array([(x, y) for x in (0.0, camera.width_px) for y in (0.0, camera.height_px)])
    rays = camera.unproject(corners)
    if not rays.valid.all():
        return min(camera.angle_limit_rad, np.pi)
    return float(np.arccos(np.clip(rays.direction[:, 2], -1.0, 1.0)).max())


def _fill_f_theta(lens: Any, camera: Camera) -> None:
    """Fill the message: lengths are in pixels of the y axis; the ratio of the focal lengths is `linear_c`."""
    if any(camera.distortion) and camera.model in ("brown_conrady", "rational"):
        raise UsageError(
            f"camera model {camera.model} has no f-theta polynomial", expected="a pinhole or a fisheye",
            remedy="send the camera as it is: lens = \"own\"",
        )  # fmt: skip
    limit = _image_angle(camera)
    angles = np.linspace(0.0, limit, _SAMPLES)
    rays = np.column_stack([np.zeros(_SAMPLES), np.sin(angles), np.cos(angles)])
    radius: Float64 = camera.project(rays).uv_px[:, 1] - camera.cy_px
    if camera.model == "f_theta":
        forward = camera.fy_px * np.array(camera.distortion)
    else:
        forward = _fit(angles, radius, lambda error, _: error)
    slope = np.gradient(radius, angles)
    # An error of the angle moves a point by the slope times as many pixels.
    backward = _fit(radius, angles, lambda error, _: error * slope)
    lens.principal_point_x, lens.principal_point_y = camera.cx_px, camera.cy_px
    lens.reference_poly = lens.ANGLE_TO_PIXELDIST
    lens.angle_to_pixeldist_poly[:] = forward.tolist()
    lens.pixeldist_to_angle_poly[:] = backward.tolist()
    lens.max_angle = limit
    lens.linear_cde.linear_c = camera.fx_px / camera.fy_px


def _from_f_theta(lens: Any, width: int, height: int, place: str) -> Camera:
    c, d, e = 1.0, 0.0, 0.0
    if lens.HasField("linear_cde"):
        c, d, e = lens.linear_cde.linear_c, lens.linear_cde.linear_d, lens.linear_cde.linear_e
    if d or e:
        raise UsageError("linear_d or linear_e is not 0", place=place, expected="axes at a right angle")
    forward, backward = np.array(lens.angle_to_pixeldist_poly), np.array(lens.pixeldist_to_angle_poly)
    if len(forward) and (lens.reference_poly != lens.PIXELDIST_TO_ANGLE or not len(backward)):
        if abs(forward[0]) > FIT_PX:
            raise UsageError(f"the radius at angle 0 is {forward[0]:g} px", place=place, expected="0")
        coefficients = np.concatenate([[0.0], forward[1:]])
    elif len(backward):
        reach = float(np.hypot(width, height))
        radius = np.linspace(0.0, reach, _SAMPLES)
        angle = np.polynomial.polynomial.polyval(radius, backward)
        limit = lens.max_angle or np.pi
        bent = np.flatnonzero((np.diff(angle) <= 0.0) | (angle[1:] > limit))
        count = int(bent[0]) + 1 if len(bent) else _SAMPLES
        if count < _SAMPLES // 8 or abs(angle[0]) > 1e-6:
            raise UsageError(
                "the polynomial does not increase from 0", place=place, expected="an angle for each radius"
            )
        coefficients = _fit(angle[:count], radius[:count], lambda error, _: error)
    else:
        raise UsageError("an f-theta lens without a polynomial", place=place, expected="coefficients")
    return Camera(
        "f_theta", width, height, c, 1.0, lens.principal_point_x, lens.principal_point_y, tuple(coefficients.tolist())
    )


def _fit(x: Float64, y: Float64, to_pixels: Callable[[Float64, Float64], Float64]) -> Float64:
    """Coefficients, lowest first and 0 at 0, of the polynomial of least degree that fits to half of `FIT_PX`.

    Raises:
        UsageError: the best of them misses by more than `FIT_PX`.
    """
    scale = float(x[-1])
    best: Float64 = np.zeros(1)
    least = np.inf
    for degree in _DEGREES:
        powers = (x[:, None] / scale) ** np.arange(1, degree + 1)
        weights = np.ones(len(x))
        for _ in range(8):
            # Weights that follow the error bring the solution near the least greatest error (Lawson, 1961).
            root = np.sqrt(weights)
            numbers = np.asarray(np.linalg.lstsq(powers * root[:, None], y * root, rcond=None)[0], np.float64)
            error = np.abs(to_pixels(powers @ numbers - y, x))
            if error.max() < least:
                least = float(error.max())
                best = np.concatenate([np.zeros(1), numbers / scale ** np.arange(1, degree + 1)])
            weights *= error + 1e-3 * error.max() + 1e-300
            weights /= weights.max()
        if least <= 0.5 * FIT_PX:
            return best
    if not least <= FIT_PX:
        raise UsageError(
            f"the best f-theta polynomial misses by {least:.2f} px", expected=f"at most {FIT_PX} px",
            remedy='a smaller image, or lens = "own"',
        )  # fmt: skip
    return best
