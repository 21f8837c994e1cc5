"""Poses of cameras on the vehicle as people write them: a place, and angles or a quaternion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.geometry.quaternions import quaternion_multiply, quaternion_normalise
from mirror.recordings.coordinates import UNIT_TOLERANCE

MOUNTING_FORM = "x,y,z,roll,pitch,yaw in metres and degrees, or qw,qx,qy,qz,tx_m,ty_m,tz_m"


def parse_mounting(text: str, place: str) -> tuple[float, ...]:
    """Return the pose of a camera in the ego frame, from text with commas; see `mounting_pose`.

    Args:
        text: six or seven numbers.
        place: the option, for messages.

    Raises:
        UsageError: these are no such numbers.
    """
    try:
        return mounting_pose([float(part) for part in text.split(",")])
    except ValueError as error:
        raise UsageError(f"{text!r} is no mounting: {error}", place=place, expected=MOUNTING_FORM) from error


def mounting_pose(numbers: Sequence[float]) -> tuple[float, ...]:
    """Return the pose of a camera in the ego frame.

    Args:
        numbers: six: ``x, y, z`` in metres, then ``roll, pitch, yaw`` in degrees, right-handed about x (forward), y
            (left) and z (up), applied in this order; with angles of 0 the camera looks forward, its image upright. Or
            seven: ``qw, qx, qy, qz, tx_m, ty_m, tz_m`` of the camera frame (x right, y down, z forward).

    Returns:
        ``ego_SE3_camera`` as ``qw qx qy qz tx_m ty_m tz_m``.

    Raises:
        ValueError: there are other numbers of them, one is not finite, or the quaternion is off unit length.
    """
    values = np.array(numbers, np.float64)
    if len(values) not in (6, 7) or not np.isfinite(values).all():
        raise ValueError("six or seven finite numbers are needed")
    if len(values) == 7:
        length = float(np.linalg.norm(values[:4]))
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"the quaternion has length {length:.4g}, not 1")
        return (*quaternion_normalise(values[:4]).tolist(), *values[4:].tolist())
    half = np.deg2rad(values[3:]) / 2.0
    # The camera frame seen from a body with x forward, y left, z up.
    rotation: Float64 = np.array([0.5, -0.5, 0.5, -0.5])
    for axis in range(3):
        turn = np.zeros(4)
        turn[0], turn[1 + axis] = np.cos(half[axis]), np.sin(half[axis])
        rotation = quaternion_multiply(turn, rotation)
    return (*quaternion_normalise(rotation).tolist(), *values[:3].tolist())
