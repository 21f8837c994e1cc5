"""The exponential map of SE(3) and its inverse, as kernels for `Poses.exp` and `Poses.log`.

A twist is a rotation vector w and a velocity v; its motion turns by exp(w) and shifts by V v with
V = 1 + (1 - cos a)/a^2 [w] + (a - sin a)/a^3 [w]^2, a = |w|. Both maps are accurate to rounding in norm at every angle
up to and including pi: where a coefficient cancels, it is multiplied by the square of a small angle.

Source: J. Sola, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics", arXiv:1812.01537.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import AnyArray
from mirror.geometry.blocks import split

_SERIES_BELOW_RAD: Final = 1e-2


def exp_kernel(out: AnyArray, twist: AnyArray) -> None:
    """Write quaternions (not yet canonical) and translations into ``out`` (..., 7) for twists (..., 6)."""
    given = split(twist)
    turn, velocity = given[:3], given[3:]
    squared = turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2]
    half = 0.5 * np.sqrt(squared)
    cosine = np.cos(half)
    ratio = np.where(half == 0.0, 1.0, np.sin(half) / np.where(half == 0.0, 1.0, half))
    small = squared < _SERIES_BELOW_RAD**2
    series = 1 / 6 - squared / 120 + squared * squared / 5040
    twice = np.where(small, series, (1.0 - ratio * cosine) / np.where(small, 1.0, squared))
    out[..., 0] = cosine
    for axis in range(3):
        np.multiply(0.5 * ratio, turn[axis], out=out[..., 1 + axis])
    _left_jacobian(out[..., 4:], turn, velocity, 0.5 * ratio * ratio, twice)


def log_kernel(out: AnyArray, motion: AnyArray) -> None:
    """Write twists into ``out`` (..., 6) for canonical quaternions and translations (..., 7)."""
    given = split(motion)
    cosine, axis, translation = given[0], given[1:4], given[4:]
    sine = np.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    angle = 2.0 * np.arctan2(sine, cosine)
    # The ratio tends to 2 / qw; the same, possibly underflowing, sine stands in both places.
    ratio = np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 2.0)
    turn = ratio * axis
    small = angle < _SERIES_BELOW_RAD
    squared = angle * angle
    twice = np.where(small, 1 / 12 + squared / 720, (1.0 - 0.5 * ratio * cosine) / np.where(small, 1.0, squared))
    out[..., :3] = turn.transpose(*range(1, turn.ndim), 0)
    _left_jacobian(out[..., 3:], turn, translation, -0.5, twice)


def _left_jacobian(out: AnyArray, turn: AnyArray, vector: AnyArray, once: AnyArray | float, twice: AnyArray) -> None:
    across = _cross(turn, vector)
    for axis, (first, second) in enumerate(zip(across, _cross(turn, across))):
        np.add(vector[axis], once * first + twice * second, out=out[..., axis])


def _cross(a: AnyArray, b: AnyArray | list[AnyArray]) -> list[AnyArray]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
