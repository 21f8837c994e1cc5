"""Lenses with distortion, and the constants of the unscented transform.

Coefficients have gsplat's names, in OpenCV's order. A Gaussian is projected through a lens by the unscented transform
(gsplat 1.6.0, commit 1db12c01, `with_ut` without `with_eval3d`): seven points of the Gaussian are projected, and their
mean and covariance are the ellipse that is blended.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mirror.errors import UsageError

UT_ALPHA = 0.1
UT_BETA = 2.0
UT_KAPPA = 0.0
UT_SPREAD = UT_ALPHA * math.sqrt(3.0 + UT_KAPPA)
"""Distance of the points from the mean, in standard deviations."""

IMAGE_MARGIN = 0.1
"""A Gaussian is visible if one of its points lies in the image or within this share of the image size beside it."""

RADIAL_MIN = 0.8
"""A point with a smaller radial factor of a pinhole's distortion does not count as visible: near the fold of the
polynomial the projection is not reliable."""

_COEFFICIENTS = {"pinhole": (6, 2, 4), "fisheye": (4, 0, 0)}


@dataclass(frozen=True, kw_only=True)
class LensDistortion:
    """The distortion of a lens.

    Attributes:
        model: `pinhole` (Brown-Conrady, rational) or `fisheye` (equidistant, Kannala-Brandt).
        radial_coeffs: k1 .. k6 of a pinhole (k4 .. k6 in the denominator), k1 .. k4 of a fisheye.
        tangential_coeffs: p1, p2 of a pinhole.
        thin_prism_coeffs: s1 .. s4 of a pinhole.

    Raises:
        UsageError: a wrong number of coefficients, or one that is not finite.
    """

    model: Literal["pinhole", "fisheye"]
    radial_coeffs: tuple[float, ...] = ()
    tangential_coeffs: tuple[float, ...] = ()
    thin_prism_coeffs: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.model not in _COEFFICIENTS:
            raise UsageError(f"no lens {self.model!r}", place="camera_model", expected=" or ".join(_COEFFICIENTS))
        for name, needed in zip(("radial_coeffs", "tangential_coeffs", "thin_prism_coeffs"), _COEFFICIENTS[self.model]):
            given = tuple(float(value) for value in getattr(self, name)) or (0.0,) * needed
            if len(given) != needed or not all(map(math.isfinite, given)):
                raise UsageError(
                    f"{given}", place=name, expected=f"{needed} finite numbers for a {self.model}, or none"
                )
            object.__setattr__(self, name, given)

    def max_angle(self, fx: float, fy: float, cx: float, cy: float, width: int, height: int) -> float:
        """Compute the largest angle to the optical axis that a fisheye shows, radians.

        It is the smaller of two angles: where the polynomial has its first maximum (the smallest positive root of its
        derivative), and where the equidistant model reaches the farthest corner. gsplat searches the root from 1.57 by
        Newton's method if k4 is not zero.

        Args:
            fx: focal length, pixels.
            fy: focal length, pixels.
            cx: principal point, pixels.
            cy: principal point, pixels.
            width: width of the image, pixels.
            height: height of the image, pixels.
        """
        k1, k2, k3, k4 = self.radial_coeffs
        roots = np.roots([9.0 * k4, 7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
        squares = [root.real for root in roots if abs(root.imag) <= 1e-9 * abs(root) and root.real > 0.0]
        corner = math.hypot(max(width - cx, cx), max(height - cy, cy))
        return min(max(corner / fx, corner / fy), *(math.sqrt(square) for square in squares), math.inf)
