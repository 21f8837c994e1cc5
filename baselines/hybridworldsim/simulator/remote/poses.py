"""Poses and stamps as messages. Numbers are float32 on the wire: coordinates count from a place nearby."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
    """Convert a vector to a message."""
    return wire().Vec3(x=x, y=y, z=z)


def from_pose(pose: Any, place: str) -> Poses:
    """Return the pose of a message.

    Raises:
        UsageError: a number is not finite, or the quaternion has another length than 1.
    """
    turns, shifts = _numbers([pose], [place])
    return Poses(turns, shifts)


def flat(poses: Sequence[Any], places: Sequence[str]) -> Float64:
    """Return x, y and yaw (N, 3) of messages of poses.

    Raises:
        UsageError: see `from_pose`; the message names the place.
    """
    turns, shifts = _numbers(poses, places)
    w, x, y, z = turns.T
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.column_stack([shifts[:, :2], yaw])


def _numbers(poses: Sequence[Any], places: Sequence[str]) -> tuple[Float64, Float64]:
    turns = np.array([(p.quat.w, p.quat.x, p.quat.y, p.quat.z) for p in poses], np.float64).reshape(-1, 4)
    shifts = np.array([(p.vec.x, p.vec.y, p.vec.z) for p in poses], np.float64).reshape(-1, 3)
    length = np.linalg.norm(turns, axis=1)
    wrong = np.flatnonzero(~(np.isfinite(shifts).all(axis=1) & (np.abs(length - 1.0) < _UNIT)))
    if len(wrong):
        first = wrong[0]
        raise UsageError(
            f"vec {shifts[first].tolist()}, quat {turns[first].tolist()}", place=places[first],
            expected="finite numbers and a quaternion of length 1",
        )  # fmt: skip
    return turns / length[:, None], shifts


def to_us(stamp_ns: int) -> int:
    """Return nanoseconds in whole microseconds."""
    return stamp_ns // 1000
