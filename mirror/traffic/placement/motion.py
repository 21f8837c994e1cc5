"""The pose of a road user at one time, and its motion over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mirror.arrays import Float64
from mirror.geometry import Poses, quaternion_from_matrix
from mirror.portable import scalars


@dataclass(frozen=True)
class Placement:
    """Pose and motion of a road user at one time, in the world frame.

    Attributes:
        x_m: east coordinate of the body's origin.
        y_m: north coordinate of the body's origin.
        z_m: height of the ground there.
        yaw_rad: heading, counter-clockwise from east.
        pitch_rad: pitch, positive with the nose up.
        roll_rad: roll, positive with the left side up.
        speed_mps: forward speed.
        along_m: distance travelled; it determines the phase of a walk.
    """

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    pitch_rad: float = 0.0
    roll_rad: float = 0.0
    speed_mps: float = 0.0
    along_m: float = 0.0

    @property
    def translation(self) -> Float64:
        """Translation (3,) of ``world_SE3_body``."""
        return np.array([self.x_m, self.y_m, self.z_m])

    @property
    def rotation(self) -> Float64:
        """Rotation (3, 3) of ``world_SE3_body``: roll first, then pitch, then yaw."""
        cos, sin = scalars.cos(self.yaw_rad), scalars.sin(self.yaw_rad)
        up_cos, up_sin = scalars.cos(self.pitch_rad), scalars.sin(self.pitch_rad)
        roll_cos, roll_sin = scalars.cos(self.roll_rad), scalars.sin(self.roll_rad)
        return np.array(
            [
                [cos * up_cos, -sin * roll_cos - cos * up_sin * roll_sin, sin * roll_sin - cos * up_sin * roll_cos],
                [sin * up_cos, cos * roll_cos - sin * up_sin * roll_sin, -cos * roll_sin - sin * up_sin * roll_cos],
                [up_sin, up_cos * roll_sin, up_cos * roll_cos],
            ]
        )

    def world_SE3_body(self) -> Poses:  # noqa: N802
        """Return the pose of the body in the world."""
        return Poses(quaternion_from_matrix(self.rotation[None]), self.translation[None])


class Motion(Protocol):
    """The placement of a road user at any time of a drive."""

    def at(self, time_s: float) -> Placement:
        """Return the placement ``time_s`` seconds after the drive's start."""
        ...


@dataclass(frozen=True)
class StaticMotion:
    """A motion that stays at one placement, such as a parked car's."""

    placement: Placement

    def at(self, time_s: float) -> Placement:
        """Return the placement, which does not change with time."""
        return self.placement
