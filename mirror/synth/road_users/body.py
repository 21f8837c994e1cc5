"""What a road user is: a body, a motion and a name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mirror.arrays import Float64
from mirror.geometry import Poses, quaternion_from_matrix
from mirror.synth.model import Model


@dataclass(frozen=True, eq=False)
class Body:
    """What a road user looks like, in its own frame: x forward, y left, z up, origin on the ground below its centre.

    Attributes:
        category: the class in its 3D boxes.
        size_m: length, width, height of its 3D box, which stands on the origin.
        model: within the box to a millimetre.
    """

    category: str
    size_m: tuple[float, float, float]
    model: Model

    def posed(self, placement: Placement) -> Model:
        """The model as it moves, within the box too: people walk, all others keep their shape."""
        return self.model


def boxed(category: str, model: Model) -> Body:
    """The body of a model with the least box about it, its origin moved below the box's middle."""
    low, high = model.bounds()
    middle = 0.5 * (low[0] + high[0])
    size = float(high[0] - low[0]), 2.0 * float(max(high[1], -low[1])), float(high[2])
    return Body(category, size, model.standing(-middle, 0.0))


@dataclass(frozen=True)
class Saddle:
    """Where somebody sits on a two-wheeler: places in the body's frame, metres.

    Attributes:
        hip: where the pelvis rests on the saddle; its y is 0.
        hand: the left grip; the right one mirrors it.
        foot: the left pedal or peg, under the sole.
        foot_right: the right one: pedals are half a turn apart.
    """

    hip: tuple[float, float, float]
    hand: tuple[float, float, float]
    foot: tuple[float, float, float]
    foot_right: tuple[float, float, float]


@dataclass(frozen=True)
class Placement:
    """Where a road user is at an instant, in the world.

    Attributes:
        x_m: of the body's origin, to the east.
        y_m: to the north.
        z_m: height of the ground there.
        yaw_rad: counter-clockwise from east.
        pitch_rad: nose upwards.
        roll_rad: left side upwards.
        speed_mps: forwards.
        along_m: how far it has moved: people set their feet by it.
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
        """(3,) of ``world_SE3_body``."""
        return np.array([self.x_m, self.y_m, self.z_m])

    @property
    def rotation(self) -> Float64:
        """(3, 3) of ``world_SE3_body``: roll first, then pitch, then yaw."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        up_cos, up_sin = math.cos(self.pitch_rad), math.sin(self.pitch_rad)
        roll_cos, roll_sin = math.cos(self.roll_rad), math.sin(self.roll_rad)
        return np.array(
            [
                [cos * up_cos, -sin * roll_cos - cos * up_sin * roll_sin, sin * roll_sin - cos * up_sin * roll_cos],
                [sin * up_cos, cos * roll_cos - sin * up_sin * roll_sin, -cos * roll_sin - sin * up_sin * roll_cos],
                [up_sin, up_cos * roll_sin, up_cos * roll_cos],
            ]
        )

    def world_SE3_body(self) -> Poses:  # noqa: N802
        """Its pose."""
        return Poses(quaternion_from_matrix(self.rotation[None]), self.translation[None])


class Motion(Protocol):
    """Where something is at any time of a drive."""

    def at(self, time_s: float) -> Placement:
        """The placement ``time_s`` after the drive's start."""
        ...


@dataclass(frozen=True)
class StaticMotion:
    """Standing where it is: parked cars."""

    placement: Placement

    def at(self, time_s: float) -> Placement:
        """The placement, at all times."""
        return self.placement


@dataclass(frozen=True, eq=False)
class RoadUser:
    """One road user of a drive: its boxes carry ``track_id``."""

    track_id: str
    body: Body
    motion: Motion
