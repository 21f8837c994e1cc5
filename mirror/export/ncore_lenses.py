"""Lenses in the parameters of NCore, which are float32; `mirror.recordings.readers.ncore_lenses` reads them back."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from mirror.geometry.cameras import Camera
from mirror.recordings.readers.f_theta_fit import sample_directions
from mirror.recordings.readers.ncore_lenses import SHUTTERS

_DEGREE: Final = 5
_LARGEST_RAD: Final = 1.5
_SAMPLES: Final = 400


def to_ncore(camera: Camera, shutter: str) -> Any:
    """Return the parameters of a lens: ideal or OpenCV pinhole, OpenCV fisheye, or f-theta.

    Args:
        camera: the lens.
        shutter: MIRROR's word for the direction of its shutter.
    """
    from ncore.data import (
        FThetaCameraModelParameters,
        IdealPinholeCameraModelParameters,
        OpenCVFisheyeCameraModelParameters,
        OpenCVPinholeCameraModelParameters,
        ShutterType,
    )

    names = {word: name for name, word in SHUTTERS.items()}
    common: dict[str, Any] = {
        "resolution": np.array([camera.width_px, camera.height_px], np.uint64),
        "shutter_type": ShutterType[names[shutter]],
    }
    centre = np.array([camera.cx_px, camera.cy_px], np.float32)
    if camera.model == "f_theta":
        return _f_theta(camera, common, FThetaCameraModelParameters)
    common |= {"principal_point": centre, "focal_length": np.array([camera.fx_px, camera.fy_px], np.float32)}
    if camera.model == "pinhole":
        return IdealPinholeCameraModelParameters(**common)
    if camera.model == "kannala_brandt":
        radial = np.array(camera.distortion, np.float32)
        return OpenCVFisheyeCameraModelParameters(radial_coeffs=radial, max_angle=_widest_rad(camera), **common)
    k1, k2, p1, p2, k3, *denominator = camera.distortion
    radial = np.array([k1, k2, k3, *(denominator or (0.0, 0.0, 0.0))], np.float32)
    return OpenCVPinholeCameraModelParameters(
        radial_coeffs=radial, tangential_coeffs=np.array([p1, p2], np.float32),
        thin_prism_coeffs=np.zeros(4, np.float32), **common,
    )  # fmt: skip


def _f_theta(camera: Camera, common: dict[str, Any], kind: Any) -> Any:
    """Return an f-theta lens: exact from angle to radius, a fitted polynomial back."""
    forward = camera.fy_px * np.array(camera.distortion, np.float64)
    widest = _widest_rad(camera)
    angle = np.linspace(0.0, widest, _SAMPLES)
    radius = np.polynomial.polynomial.polyval(angle, forward)
    design = np.stack([radius**power for power in range(1, _DEGREE + 1)], axis=1)
    scale = np.abs(design).max(axis=0)
    backward = np.concatenate([[0.0], np.linalg.lstsq(design / scale, angle, rcond=None)[0] / scale])
    return kind(
        # An f-theta lens counts its principal point from the centre of the first pixel.
        principal_point=np.array([camera.cx_px - 0.5, camera.cy_px - 0.5], np.float32),
        reference_poly=kind.PolynomialType.ANGLE_TO_PIXELDIST,
        pixeldist_to_angle_poly=backward.astype(np.float32),
        angle_to_pixeldist_poly=forward.astype(np.float32),
        max_angle=widest,
        linear_cde=np.array([camera.fx_px / camera.fy_px, 0.0, 0.0], np.float32),
        **common,
    )


def _widest_rad(camera: Camera) -> float:
    """Return the largest angle from the axis of a pixel of the border; `_LARGEST_RAD` where none of them has a ray."""
    x, y = np.linspace(0.0, camera.width_px, 64), np.linspace(0.0, camera.height_px, 64)
    border = [(u, v) for u in x for v in (0.0, float(camera.height_px))]
    border += [(u, v) for v in y for u in (0.0, float(camera.width_px))]
    rays = camera.unproject(np.array(border)).direction
    angles = np.arctan2(np.linalg.norm(rays[:, :2], axis=1), rays[:, 2])
    known = angles[np.isfinite(angles)]
    return float(known.max()) if len(known) else _LARGEST_RAD


def lens_error_px(camera: Camera, found: Camera) -> float:
    """Return the largest distance (px) between the pixels of two lenses, over the image."""
    directions = sample_directions(min(_widest_rad(camera), np.pi * 0.99))
    one, other = camera.project(directions), found.project(directions)
    inside = (one.uv_px >= 0.0).all(axis=1) & (one.uv_px <= (camera.width_px, camera.height_px)).all(axis=1)
    shown = inside & np.isfinite(other.uv_px).all(axis=1)
    return float(np.linalg.norm(one.uv_px[shown] - other.uv_px[shown], axis=1).max(initial=0.0))
