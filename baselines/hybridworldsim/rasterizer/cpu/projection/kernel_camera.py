"""A camera and its limits of visibility, in the form that kernels take."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hybridworldsim.rasterizer.lenses import LensDistortion
from hybridworldsim.rasterizer.presets import SQUARE_DISCRIMINANT_MIN, SQUARE_SIGMAS, GsplatPreset
from mirror.arrays import Float64

DEPTH_MIN = 1e-30
"""Least depth, metres: Gaussians on or behind the camera plane are culled."""

_UNBOUNDED = 1e300  # pixels; a lens may project any direction into the image
_SIGMAS = 3.33  # distance in standard deviations at which an opaque Gaussian is below ALPHA_MIN


class KernelCamera(NamedTuple):
    """A camera and its limits of visibility.

    Attributes:
        antialiased: whether opacities are multiplied by the compensation.
        square: whether the extent is the square of three sigmas.
        r00: to `r22`, rotation of the view matrix; `t0` to `t2` its translation, metres.
        fx: `fy`, `cx`, `cy`: the pinhole, pixels.
        left: `right`, `top`, `bottom`: bounds of x/z and y/z in the Jacobian.
        near: `far`: range of depths in which Gaussians are kept, metres.
        blur: added to both variances, pixel^2.
        clip: Gaussians with smaller or equal radii are culled, pixels.
        reach_x: `reach_y`, `margin`: the radius of a Gaussian of opacity 1 is below `reach_x` * greatest scale / depth
            + `margin`, pixels.
        ratio_min: lower bound of the squared compensation.
    """

    antialiased: bool
    square: bool
    r00: float
    r01: float
    r02: float
    r10: float
    r11: float
    r12: float
    r20: float
    r21: float
    r22: float
    t0: float
    t1: float
    t2: float
    fx: float
    fy: float
    cx: float
    cy: float
    left: float
    right: float
    top: float
    bottom: float
    width: float
    height: float
    near: float
    far: float
    blur: float
    clip: float
    reach_x: float
    reach_y: float
    margin: float
    ratio_min: float


def to_kernel_camera(
    viewmat: Float64,
    K: Float64,
    width: int,
    height: int,
    *,
    eps2d: float,
    near_plane: float,
    far_plane: float,
    radius_clip: float,
    preset: GsplatPreset,
    antialiased: bool,
    lens: LensDistortion | None,
) -> KernelCamera:
    """Convert a camera to the form that kernels take.

    Args:
        viewmat: (4, 4), world to camera.
        K: (3, 3) intrinsic matrix, pixels.
        width: width of the image, pixels.
        height: height of the image, pixels.
        eps2d: added to both variances, pixel^2.
        near_plane: least depth, metres; Gaussians on or behind the camera plane are always culled.
        far_plane: greatest depth, metres.
        radius_clip: Gaussians with smaller or equal radii are culled, pixels.
        preset: generation of gsplat.
        antialiased: whether opacities are multiplied by the compensation.
        lens: None for a pinhole.
    """
    fx, fy, cx, cy = float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])
    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy
    right, left = (width - cx) / fx + margin_x, -cx / fx - margin_x
    bottom, top = (height - cy) / fy + margin_y, -cy / fy - margin_y
    stretch = float(np.linalg.norm(viewmat[:3, :3], 2)) * (1.0 + 1e-9)
    reach_x = stretch * abs(fx) * float(np.hypot(1.0, max(abs(left), abs(right))))
    reach_y = stretch * abs(fy) * float(np.hypot(1.0, max(abs(top), abs(bottom))))
    square = preset.extent == "square"
    if lens is not None:
        reaches = (0.0, 0.0, _UNBOUNDED)
    elif square:
        reach = SQUARE_SIGMAS * float(np.hypot(reach_x, reach_y))
        reaches = (reach, reach, SQUARE_SIGMAS * (2.0 * eps2d + SQUARE_DISCRIMINANT_MIN**0.5) ** 0.5 + 1.0)
    else:
        reaches = (_SIGMAS * reach_x, _SIGMAS * reach_y, _SIGMAS * eps2d**0.5 + 1.0)
    numbers = [
        *viewmat[:3, :3].ravel(),
        *viewmat[:3, 3],
        *(fx, fy, cx, cy, left, right, top, bottom, width, height),
        *(max(near_plane, DEPTH_MIN), far_plane, eps2d, radius_clip),
        *(*reaches, preset.compensation_min**2),
    ]
    return KernelCamera(antialiased, square, *map(float, numbers))
