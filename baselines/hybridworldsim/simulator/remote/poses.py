"""Poses and stamps as messages. Numbers are float32 on the wire: coordinates count from a place nearby."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hybridworldsim.simulator.remote.messages import wire
from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.geometry import Poses

_UNIT: Final = 1e-3


def to_pose(pose: Poses) -> Any:
    """Return one pose as a message."""
    messages = wire()
    w, x, y, z = pose.rotation[0].tolist()
    return messages.Pose(vec=vector(*pose.translation[0].tolist()), quat=messages.Quat(w=w, x=x, y=y, z=z))


def to_flat_pose(x_m: float, y_m: float, yaw_rad: float) -> Any:
    """Return a pose on the plane as a message."""
    messages = wire()
    turn = messages.Quat(w=math.cos(0.5 * yaw_rad), x=0.0, y=0.0, z=math.sin(0.5 * yaw_rad))
    return messages.Pose(vec=vector(x_m, y_m, 0.0), quat=turn)


def vector(x: float, y: float, z: float) -> Any:
    """Return a vector as a message."""
    return wire().Vec3(x=x, y=y, z=z)


def from_pose(pose: Any, place: str) -> Poses:
    """Return the pose of a message.

    Raises:
        UsageError: a number is not finite, or the quaternion has another length than 1.
    """
    turn = np.array([pose.quat.w, pose.quat.x, pose.quat.y, pose.quat.z])
    shift = np.array([pose.vec.x, pose.vec.y, pose.vec.z])
    length = float(np.linalg.norm(turn))
    if not (np.isfinite(shift).all() and abs(length - 1.0) < _UNIT):
        raise UsageError(
            f"vec {shift.tolist()}, quat {turn.tolist()}", place=place,
            expected="finite numbers and a quaternion of length 1",
        )  # fmt: skip
    return Poses(turn[None] / length, shift[None])


def flat(pose: Any, place: str) -> Float64:
    """Return x, y and yaw of a message.

    Raises:
        UsageError: see `from_pose`.
    """
    there = from_pose(pose, place)
    w, x, y, z = there.rotation[0].tolist()
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.array([*there.translation[0, :2], yaw])


def to_us(stamp_ns: int) -> int:
    """Return nanoseconds in whole microseconds."""
    return stamp_ns // 1000
