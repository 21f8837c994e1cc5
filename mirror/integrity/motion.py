"""How the vehicle moves from pose to pose, in columns over all files of poses."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.integrity.rows import Rows

_POSITION = ("tx_m", "ty_m", "tz_m")
_ROTATION = ("qw", "qx", "qy", "qz")
_UNIT_TOLERANCE = 1e-6


class Motion:
    """Columns derived from poses; a value that needs what is missing or broken is NaN, and compares as false.

    Args:
        poses: of any number of files.
    """

    def __init__(self, poses: Rows) -> None:
        self.poses = poses

    @cached_property
    def position(self) -> Float64:
        """(N, 3) in the world."""
        return np.column_stack([self.poses.floats(name) for name in _POSITION])

    @cached_property
    def rotation(self) -> Float64:
        """(N, 4) as stored."""
        return np.column_stack([self.poses.floats(name) for name in _ROTATION])

    @cached_property
    def unit(self) -> Bool:
        """(N,) True where the rotation is of unit length, to a millionth."""
        return np.asarray(np.abs(np.linalg.norm(self.rotation, axis=1) - 1.0) <= _UNIT_TOLERANCE)

    @cached_property
    def step_s(self) -> Float64:
        """(N,) time since the pose above; NaN where there is none, or where time does not go forward."""
        stamps = self.poses.integers("timestamp_ns")
        seconds = np.diff(stamps, prepend=stamps[:1]) * 1e-9
        return np.where(self.poses.same_file & (seconds > 0), seconds, np.nan)

    @cached_property
    def step_m(self) -> Float64:
        """(N, 3) way since the pose above."""
        way = np.diff(self.position, axis=0, prepend=self.position[:1])
        return np.where(self.poses.same_file[:, None], way, np.nan)

    @cached_property
    def distance_m(self) -> Float64:
        """(N,) horizontal distance from the pose above."""
        return np.asarray(np.hypot(self.step_m[:, 0], self.step_m[:, 1]))

    @cached_property
    def speed_mps(self) -> Float64:
        """(N,) horizontal speed since the pose above."""
        return self.distance_m / self.step_s

    def forward(self) -> Float64:
        """(N, 2) horizontal direction of the ego's x axis, not normalised."""
        w, x, y, z = self.rotation.T
        return np.column_stack([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)])

    def up(self) -> Float64:
        """(N,) cosine of the angle between the ego's z axis and up."""
        _, x, y, _ = self.rotation.T
        return 1.0 - 2.0 * (x * x + y * y)
