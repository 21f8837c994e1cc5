"""Lenses that are no pinhole, and the constants by which Gaussians are seen through them.

Coefficients carry the names that gsplat gives them, in OpenCV's order. A Gaussian passes a lens by the unscented
transform (gsplat 1.6.0, commit 1db12c01, `with_ut` without `with_eval3d`): seven points of it pass the lens, their mean
and covariance are the ellipse that is blended.
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
"""How far the points lie from the mean, in standard deviations."""

IMAGE_MARGIN = 0.1
"""A Gaussian is seen if one of its points lies in the picture or within this part of its size beside it."""

RADIAL_MIN = 0.8
"""A point that the radial distortion of a pinhole's lens draws in further than this does not count as seen: near a
folding lens nothing can be trusted."""

_COEFFICIENTS = {"pinhole": (6, 2, 4), "fisheye": (4, 0, 0)}


@dataclass(frozen=True, kw_only=True)
class Lens:
    """How a lens bends what a pinhole would show.

    Attributes:
        model: `pinhole` (Brown-Conrady, rational) or `fisheye` (equidistant, Kannala-Brandt).
        radial_coeffs: k1 .. k6 of a pinhole (k4 .. k6 in the denominator), k1 .. k4 of a fisheye.
        tangential_coeffs: p1, p2 of a pinhole.
        thin_prism_coeffs: s1 .. s4 of a pinhole.

    Raises:
        UsageError: a number of coefficients that the model does not have, or one that is not finite.
    """

    model: Literal["pinhole", "fisheye"]
    radial_coeffs: tuple[float, ...] = ()
    tangential_coeffs: tuple[float, ...] = ()
    thin_prism_coeffs: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.model not in _COEFFICIENTS:
            raise UsageError(f"no lens {self.model!r}", place="camera_model", expected=" or ".join(_COEFFICIENTS))
        for name, wanted in zip(("radial_coeffs", "tangential_coeffs", "thin_prism_coeffs"), _COEFFICIENTS[self.model]):
            given = tuple(float(value) for value in getattr(self, name)) or (0.0,) * wanted
            if len(given) != wanted or not all(map(math.isfinite, given)):
                raise UsageError(
                    f"{given}", place=name, expected=f"{wanted} finite numbers for a {self.model}, or none"
                )
            object.__setattr__(self, name, given)

    def max_angle(self, fx: float, fy: float, cx: float, cy: float, width: int, height: int) -> float:
        """The angle to the optical axis beyond which a fisheye shows nothing, radians.

        Either where its polynomial turns back (the smallest positive root of its derivative) or where the equidistant
        model leaves the farthest corner. gsplat searches the root from 1.57 by Newton's method if k4 is not zero.

        Args:
            fx: focal length, pixels.
            fy: focal length, pixels.
            cx: principal point, pixels.
            cy: principal point, pixels.
            width: of the picture, pixels.
            height: of the picture, pixels.
        """
        k1, k2, k3, k4 = self.radial_coeffs
        roots = np.roots([9.0 * k4, 7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
        turns = [root.real for root in roots if abs(root.imag) <= 1e-9 * abs(root) and root.real > 0.0]
        corner = math.hypot(max(width - cx, cx), max(height - cy, cy))
        return min(max(corner / fx, corner / fy), *(math.sqrt(turn) for turn in turns), math.inf)
