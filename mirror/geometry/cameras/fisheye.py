"""Lenses that image an angle: Kannala-Brandt and f-theta.

A ray at the angle ``theta`` from the optical axis is imaged at the radius ``c_0 + c_1 theta + c_2 theta^2 + ...`` from
the principal point, in its own direction; ``c_0 = 0``. Kannala-Brandt, as in OpenCV's fisheye model, is
``theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)`` times the focal length. Angles beyond 90 degrees are
seen as far as the radius still grows.

Sources: J. Kannala, S. Brandt, "A generic camera model and calibration method", PAMI 28(8), 2006; the OpenCV 5 manual,
"Fisheye camera model".
"""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import AnyArray, Bool
from mirror.geometry.cameras.monotonic import InverseTable, first_positive_root

# Newton's method squares the error: a step this small leaves less than rounding behind it.
_CONVERGED: Final = 1e-8
_FAST_STEPS: Final = 4
_CAREFUL_STEPS: Final = 60


class Fisheye:
    """The radius of one camera as a polynomial of the angle.

    Attributes:
        angle_limit: angle in radians below which the radius grows; at most pi.
    """

    forward_only: Final = False
    straight: Final = False

    def __init__(self, coefficients: tuple[float, ...]) -> None:
        """Take the polynomial's coefficients, ascending, the first zero and the second positive."""
        self._polynomial = coefficients
        self._slope = tuple(power * value for power, value in enumerate(coefficients))[1:]
        self.angle_limit = min(first_positive_root(np.array(self._slope)), np.pi)
        self._largest = float(_horner(self._polynomial, np.array(self.angle_limit)))
        self._table = InverseTable(lambda angle: _horner(self._polynomial, angle), self.angle_limit)

    def project(self, x: AnyArray, y: AnyArray, z: AnyArray) -> tuple[AnyArray, AnyArray, Bool]:
        """Project points to image coordinates, and mark where the model defines them."""
        across = np.sqrt(x * x + y * y)
        angle = np.arctan2(across, z)
        inside = (angle < self.angle_limit) & ((across > 0.0) | (z > 0.0))
        scale = _horner(self._polynomial, angle) / np.where(across == 0.0, 1.0, across)
        return x * scale, y * scale, inside

    def unproject(self, u: AnyArray, v: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray, Bool]:
        """Convert image coordinates to unit rays, and mark where a ray exists."""
        radius = np.sqrt(u * u + v * v)
        reachable = radius < self._largest
        wanted = np.where(reachable, radius, 0.0)
        angle = self._table.quick(wanted)
        solved = np.zeros(angle.shape, dtype=np.bool_)
        for _ in range(_FAST_STEPS):
            step = (_horner(self._polynomial, angle) - wanted) / _horner(self._slope, angle)
            angle = angle - step
            solved = (np.abs(step) <= _CONVERGED) & (angle < self.angle_limit)
            if solved.all():
                break
        else:
            slow = np.flatnonzero(~solved)
            angle[slow] = self._angle_near_limit(wanted[slow])
        across = np.sin(angle) / np.where(wanted == 0.0, 1.0, wanted)
        return u * across, v * across, np.cos(angle), reachable & (angle < self.angle_limit)

    def _angle_near_limit(self, radius: AnyArray) -> AnyArray:
        """Newton's method within a shrinking bracket, for the few angles that need care."""
        low, high = np.zeros_like(radius), np.full_like(radius, self.angle_limit)
        angle = self._table.careful(radius)
        for _ in range(_CAREFUL_STEPS):
            excess = _horner(self._polynomial, angle) - radius
            low, high = np.where(excess < 0.0, angle, low), np.where(excess < 0.0, high, angle)
            newton = angle - excess / _horner(self._slope, angle)
            angle = np.where((newton > low) & (newton < high), newton, 0.5 * (low + high))
        return angle


def kannala_brandt_polynomial(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    """Return the polynomial of ``k1 k2 k3 k4``."""
    k1, k2, k3, k4 = coefficients
    return (0.0, 1.0, 0.0, k1, 0.0, k2, 0.0, k3, 0.0, k4)


def _horner(coefficients: tuple[float, ...], angle: AnyArray) -> AnyArray:
    total = np.full_like(angle, coefficients[-1])
    for value in coefficients[-2::-1]:
        total *= angle
        if value != 0.0:
            total += value
    return total
