"""Motion of the vehicle between poses, as columns over all files of poses."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.integrity.rows import TableRows

_POSITION = ("tx_m", "ty_m", "tz_m")
_ROTATION = ("qw", "qx", "qy", "qz")
_UNIT_TOLERANCE = 1e-6


class MotionColumns:
    """Columns derived from N poses, with NaN, which compares as false, where a value cannot be computed.

    Args:
        poses: poses of any number of files.
    """

    def __init__(self, poses: TableRows) -> None:
        self.poses = poses

    @cached_property
    def position(self) -> Float64:
        """(N, 3) positions in the world frame, in metres."""
        return np.column_stack([self.poses.floats(name) for name in _POSITION])

    @cached_property
    def rotation(self) -> Float64:
        """(N, 4) stored quaternions."""
        return np.column_stack([self.poses.floats(name) for name in _ROTATION])

    @cached_property
    def unit(self) -> Bool:
        """(N,) True where the quaternion has unit length, to 1e-6."""
        return np.asarray(np.abs(np.linalg.norm(self.rotation, axis=1) - 1.0) <= _UNIT_TOLERANCE)

    @cached_property
    def step_s(self) -> Float64:
        """(N,) time since the previous pose; NaN for the first pose, and where time does not increase."""
        stamps = self.poses.integers("timestamp_ns")
        seconds = np.diff(stamps, prepend=stamps[:1]) * 1e-9
        return np.where(self.poses.same_file & (seconds > 0), seconds, np.nan)

    @cached_property
    def step_m(self) -> Float64:
        """(N, 3) displacement since the previous pose, in metres."""
        way = np.diff(self.position, axis=0, prepend=self.position[:1])
        return np.where(self.poses.same_file[:, None], way, np.nan)

    @cached_property
    def distance_m(self) -> Float64:
        """(N,) horizontal distance from the previous pose."""
        return np.asarray(np.hypot(self.step_m[:, 0], self.step_m[:, 1]))

    @cached_property
    def speed_mps(self) -> Float64:
        """(N,) horizontal speed since the previous pose."""
        return self.distance_m / self.step_s

    def forward(self) -> Float64:
        """Return the horizontal direction (N, 2) of the ego's x axis, not normalised."""
        w, x, y, z = self.rotation.T
        return np.column_stack([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)])

    def up(self) -> Float64:
        """Return the cosine (N,) of the angle between the ego's z axis and up."""
        _, x, y, _ = self.rotation.T
        return 1.0 - 2.0 * (x * x + y * y)
