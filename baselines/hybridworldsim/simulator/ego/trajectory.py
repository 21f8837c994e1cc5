"""A planned trajectory of the ego vehicle, and its smooth interpolation in time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError


class ReferencePoint(NamedTuple):
    """One point of a trajectory.

    Attributes:
        x_m: position of the rear axle in the world.
        y_m: position of the rear axle in the world.
        yaw_rad: heading.
        speed_mps: forward speed.
        acceleration_mps2: forward acceleration.
        curvature_radpm: curvature of the path.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    acceleration_mps2: float
    curvature_radpm: float


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of the rear axle at times, in the world.

    Attributes:
        times_s: (N,) strictly increasing times in seconds, N >= 2.
        poses: (N, 3) x, y in metres and yaw in radians.

    Raises:
        UsageError: shapes do not fit, times do not increase, or a number is not finite.
    """

    times_s: Float64
    poses: Float64

    def __post_init__(self) -> None:
        if np.ndim(self.times_s) != 1 or len(self.times_s) < 2 or np.shape(self.poses) != (len(self.times_s), 3):
            raise UsageError(
                f"times of shape {np.shape(self.times_s)} with poses of shape {np.shape(self.poses)}",
                place="trajectory",
                expected="(N,) and (N, 3) with N of 2 or more",
            )
        if not (np.isfinite(self.times_s).all() and np.isfinite(self.poses).all()):
            raise UsageError("a number is not finite", place="trajectory", expected="finite times, positions and yaws")
        if (np.diff(self.times_s) <= 0.0).any():
            raise UsageError("times do not increase", place="trajectory")

    @cached_property
    def _splines(self) -> tuple[Any, Any]:
        from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

        yaws = np.unwrap(self.poses[:, 2])
        steps = np.diff(self.poses[:, :2], axis=0)
        middle = 0.5 * (yaws[1:] + yaws[:-1])
        forward = np.sign(steps[:, 0] * np.cos(middle) + steps[:, 1] * np.sin(middle))
        length = np.concatenate([[0.0], np.cumsum(forward * np.linalg.norm(steps, axis=1))])
        # Monotonic interpolation of the length: a plan that stops does not swing back behind its last pose.
        speeds = PchipInterpolator(self.times_s, length)(self.times_s, 1)
        tangents = speeds[:, None] * np.column_stack([np.cos(yaws), np.sin(yaws)])
        positions = CubicHermiteSpline(self.times_s, self.poses[:, :2], tangents)
        return positions, PchipInterpolator(self.times_s, yaws)

    def at(self, time_s: float) -> ReferencePoint:
        """Return the point at a time; after the last pose the vehicle stands at that pose."""
        positions, yaws = self._splines
        inside = min(max(time_s, float(self.times_s[0])), float(self.times_s[-1]))
        (x, y), yaw = positions(inside), float(yaws(inside))
        if time_s > self.times_s[-1]:
            return ReferencePoint(float(x), float(y), yaw, 0.0, 0.0, 0.0)
        ahead = np.array([np.cos(yaw), np.sin(yaw)])
        speed = float(positions(inside, 1) @ ahead)
        turn = float(yaws(inside, 1))
        curvature = turn / speed if abs(speed) > 0.3 else 0.0
        return ReferencePoint(float(x), float(y), yaw, speed, float(positions(inside, 2) @ ahead), curvature)
