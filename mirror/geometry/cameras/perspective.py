"""Lenses that image a plane: pinhole, Brown-Conrady and rational distortion.

A point at ``x = X / Z, y = Y / Z`` with ``r2 = x x + y y`` is imaged at

    x' = x (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3) + 2 p1 x y + p2 (r2 + 2 x x)
    y' = y (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3) + p1 (r2 + 2 y y) + 2 p2 x y

as in OpenCV. The map is the gradient of a potential (its Jacobian is symmetric), so it is one-to-one on every disk on
which that Jacobian is positive definite; `Perspective.limit` is the radius of the largest one round the axis. Without
tangential terms that is where the radial part turns back, ``d r' / d r = 0``; with them, where
``d r' / d r = 6 sqrt(p1^2 + p2^2) r``, in the direction in which they act against it.

Sources: D. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971; the OpenCV 5 manual,
"Camera Calibration and 3D Reconstruction".
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.polynomial import Polynomial

from mirror.arrays import AnyArray, Bool
from mirror.geometry.cameras.monotonic import InverseTable, first_positive_root

# Newton's method squares the error: a step this small leaves less than rounding behind it.
_CONVERGED: Final = 1e-8
_CLOSE: Final = 1e-7
_FAST_STEPS: Final = 4
_CAREFUL_STEPS: Final = 60


class Perspective:
    """The distortion of one camera, in units of its focal length.

    Attributes:
        limit: radius ``r`` below which the distortion is invertible; infinity if it is everywhere.
    """

    forward_only: Final = True

    def __init__(self, coefficients: tuple[float, ...], reach: float) -> None:
        """Take the coefficients in OpenCV's order.

        Args:
            coefficients: none, or ``k1 k2 p1 p2 k3``, or these and ``k4 k5 k6``.
            reach: largest distorted radius in the image.
        """
        k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, *(0.0,) * (8 - len(coefficients)))
        self._numerator, self._denominator = (k1, k2, k3), (k4, k5, k6)
        self._rational = any(self._denominator)
        self._tangential = (p1, p2)
        self.straight = not any(coefficients)
        self.limit, self._farthest = (np.inf, np.inf) if self.straight else self._find_limit()
        if not self.straight:
            self._table = InverseTable(self._radial, self.limit, reach)

    @property
    def angle_limit(self) -> float:
        """The angle from the axis, in radians, that corresponds to `limit`."""
        return float(np.arctan(self.limit))

    def project(self, x: AnyArray, y: AnyArray, z: AnyArray) -> tuple[AnyArray, AnyArray, Bool]:
        """Project points to image coordinates, and mark where the model defines them."""
        front = z > 0.0
        inverse = 1.0 / np.where(front, z, 1.0)
        x, y = x * inverse, y * inverse
        squared = x * x + y * y
        inside = front & (squared < self.limit * self.limit)
        if self.straight:
            return x, y, inside
        factor = self._factor(squared)
        p1, p2 = self._tangential
        if p1 == 0.0 == p2:
            return x * factor, y * factor, inside
        # 2 (p2 x + p1 y) stands in both tangential terms.
        factor += 2.0 * (p2 * x + p1 * y)
        return x * factor + p2 * squared, y * factor + p1 * squared, inside

    def unproject(self, u: AnyArray, v: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray, Bool]:
        """Convert image coordinates to unit rays, and mark where a ray exists."""
        x, y, inside = (u, v, np.isfinite(u + v)) if self.straight else self._undistort(u, v)
        z = 1.0 / np.sqrt(1.0 + x * x + y * y)
        return x * z, y * z, z, inside

    def _undistort(self, u: AnyArray, v: AnyArray) -> tuple[AnyArray, AnyArray, Bool]:
        radius = np.sqrt(u * u + v * v)
        reachable = np.isfinite(radius) & (radius <= self._farthest)
        u, v, radius = np.where(reachable, u, 0.0), np.where(reachable, v, 0.0), np.where(reachable, radius, 0.0)
        scale = self._table.quick(radius) / np.where(radius == 0.0, 1.0, radius)
        x, y = u * scale, v * scale
        solved = np.zeros(x.shape, dtype=np.bool_)
        for _ in range(_FAST_STEPS):
            dx, dy, close = self._newton_step(x, y, u, v)
            x, y = x - dx, y - dy
            solved = close & (dx * dx + dy * dy <= _CONVERGED**2) & (x * x + y * y < self.limit * self.limit)
            if solved.all():
                return x, y, reachable
        slow = np.flatnonzero(~solved)
        x[slow], y[slow], solved[slow] = self.undistort_carefully(u[slow], v[slow], radius[slow])
        return x, y, reachable & solved

    def undistort_carefully(self, u: AnyArray, v: AnyArray, radius: AnyArray) -> tuple[AnyArray, AnyArray, Bool]:
        """Undistort the few points that need care, by shortened steps of Newton's method within the limit."""
        scale = self._table.careful(radius) / np.where(radius == 0.0, 1.0, radius)
        x, y = u * scale, v * scale
        solved = np.zeros(x.shape, dtype=np.bool_)
        for _ in range(_CAREFUL_STEPS):
            x, y = self._within_limit(x, y)
            dx, dy, close = self._newton_step(x, y, u, v)
            length = np.sqrt(dx * dx + dy * dy)
            allowed = 0.1 + 0.5 * np.sqrt(x * x + y * y)
            shorter = np.where(length > allowed, allowed / length, 1.0)
            x, y = x - shorter * dx, y - shorter * dy
            solved = close & (length <= _CONVERGED) & (x * x + y * y < self.limit * self.limit)
            if solved.all():
                break
        return x, y, solved

    def _within_limit(self, x: AnyArray, y: AnyArray) -> tuple[AnyArray, AnyArray]:
        # Not to the limit itself, where the Jacobian may be singular.
        radius = np.sqrt(x * x + y * y)
        edge = self.limit * (1.0 - _CONVERGED)
        back = np.where(radius > edge, edge / radius, 1.0) if np.isfinite(edge) else 1.0
        return x * back, y * back

    def _newton_step(self, x: AnyArray, y: AnyArray, u: AnyArray, v: AnyArray) -> tuple[AnyArray, AnyArray, Bool]:
        """The step, and whether it starts where the image is met closely: at a pole steps are short anywhere."""
        p1, p2 = self._tangential
        squared = x * x + y * y
        factor, slope = self._factor_and_slope(squared)
        factor = factor + 2.0 * (p2 * x + p1 * y)
        du = x * factor + p2 * squared - u
        dv = y * factor + p1 * squared - v
        xx = factor + 2.0 * x * (x * slope + 2.0 * p2)
        yy = factor + 2.0 * y * (y * slope + 2.0 * p1)
        xy = 2.0 * (x * y * slope + p1 * x + p2 * y)
        inverse = 1.0 / (xx * yy - xy * xy)
        close = du * du + dv * dv <= _CLOSE**2 * (1.0 + u * u + v * v)
        return (yy * du - xy * dv) * inverse, (xx * dv - xy * du) * inverse, close

    def _factor(self, squared: AnyArray) -> AnyArray:
        factor = 1.0 + squared * _horner(self._numerator, squared)
        if self._rational:
            factor /= 1.0 + squared * _horner(self._denominator, squared)
        return factor

    def _factor_and_slope(self, squared: AnyArray) -> tuple[AnyArray, AnyArray]:
        """The radial factor and its derivative by the squared radius."""
        k1, k2, k3 = self._numerator
        factor = 1.0 + squared * (k1 + squared * (k2 + squared * k3))
        slope = k1 + squared * (2.0 * k2 + squared * (3.0 * k3))
        if self._rational:
            k4, k5, k6 = self._denominator
            inverse = 1.0 / (1.0 + squared * (k4 + squared * (k5 + squared * k6)))
            factor = factor * inverse
            slope = (slope - factor * (k4 + squared * (2.0 * k5 + squared * (3.0 * k6)))) * inverse
        return factor, slope

    def _radial(self, radius: AnyArray) -> AnyArray:
        return radius * self._factor(radius * radius)

    def _find_limit(self) -> tuple[float, float]:
        """The radius up to which the distortion is invertible, and one that no distorted point exceeds."""
        radius = Polynomial((0.0, 1.0))
        squared = radius**2
        numerator = 1.0 + squared * Polynomial(self._numerator)(squared)
        denominator = 1.0 + squared * Polynomial(self._denominator)(squared)
        tangential = float(np.hypot(*self._tangential))
        radial_slope = numerator * denominator + radius * (
            numerator.deriv() * denominator - numerator * denominator.deriv()
        )
        # With q = |p| r, the Jacobian's determinant in the direction with cosine c to -(p2, p1) is
        # 16 q^2 c^2 - (2 r'' + 6 f) q c + r'' f - 4 q^2 (r'' the radial slope, f the radial factor). It is least at
        # c = 1, where it is (r'' - 6 q)(f - 2 q), as long as 10 q < 3 f; that bounds distortion beyond any lens.
        conditions = (
            radial_slope - 6.0 * tangential * radius * denominator**2,
            3.0 * numerator - 10.0 * tangential * radius * denominator,
            denominator,
        )
        turn, excess, pole = (first_positive_root(np.asarray(one.coef, dtype=np.float64)) for one in conditions)
        limit = min(turn, excess, pole)
        if limit == pole:
            return limit, np.inf
        return limit, float(self._radial(np.array(limit))) + 3.0 * tangential * limit**2


def _horner(coefficients: tuple[float, float, float], squared: AnyArray) -> AnyArray:
    first, second, third = coefficients
    return first + squared * (second + squared * third)
