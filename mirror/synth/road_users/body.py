"""Road users: a body, a motion and an id."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mirror.arrays import Float64
from mirror.geometry import Poses, quaternion_from_matrix
from mirror.synth.model import Model
from mirror.synth.portable import scalars


@dataclass(frozen=True, eq=False)
class Body:
    """Shape of a road user in its own frame: x forward, y left, z up, origin on the ground below its centre.

    Attributes:
        category: class of its 3D boxes.
        size_m: length, width and height of its 3D box, which stands on the origin.
        model: its faces, which stay within the box to 1 mm.
    """

    category: str
    size_m: tuple[float, float, float]
    model: Model

    def model_at(self, placement: Placement) -> Model:
        """The model in the pose of a placement, within the box: people walk, all others are rigid."""
        return self.model


def make_body(category: str, model: Model) -> Body:
    """Make a body from a model: compute its bounding box and move the origin below the box's middle."""
    low, high = model.bounds()
    middle = 0.5 * (low[0] + high[0])
    size = float(high[0] - low[0]), 2.0 * float(max(high[1], -low[1])), float(high[2])
    return Body(category, size, model.place(-middle, 0.0))


@dataclass(frozen=True)
class Saddle:
    """The rider's contact points on a two-wheeler, in the body's frame, metres.

    Attributes:
        hip: position of the pelvis on the saddle; its y is 0.
        hand: position of the left grip; the right one is its mirror image.
        foot: position of the left pedal or peg, under the sole.
        foot_right: position of the right pedal or peg; pedals are half a turn apart.
    """

    hip: tuple[float, float, float]
    hand: tuple[float, float, float]
    foot: tuple[float, float, float]
    foot_right: tuple[float, float, float]


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
        """The pose of the body in the world."""
        return Poses(quaternion_from_matrix(self.rotation[None]), self.translation[None])


class Motion(Protocol):
    """The placement of a road user at any time of a drive."""

    def at(self, time_s: float) -> Placement:
        """The placement ``time_s`` seconds after the drive's start."""
        ...


@dataclass(frozen=True)
class StaticMotion:
    """A motion that stays at one placement, as of parked cars."""

    placement: Placement

    def at(self, time_s: float) -> Placement:
        """The placement; it is the same at all times."""
        return self.placement


@dataclass(frozen=True, eq=False)
class RoadUser:
    """One road user of a drive; its boxes carry ``track_id``."""

    track_id: str
    body: Body
    motion: Motion
