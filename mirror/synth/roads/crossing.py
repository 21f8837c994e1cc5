"""Crossings of streets: their arms, the rounded kerbs at their corners, and their extent along each arm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.portable import arrays, scalars
from mirror.synth.roads.line import Line
from mirror.synth.roads.section import Section

Control = Literal["signal", "priority", "joint"]
"""The rule of who goes first: traffic lights decide; signs decide; no lanes cross, they only branch off or merge."""

_STRAIGHT_RAD: Final = math.radians(150.0)
_ARC_PIECES: Final = 6
_TOUCHES: Final = 12
_EXACT_M: Final = 1e-9
_INSIDE_M: Final = 1.0


@dataclass(frozen=True)
class CrossedStreet:
    """A street with its middle line and its cross-section.

    Attributes:
        name: id of the street.
        line: middle line.
        section: cross-section.
    """

    name: str
    line: Line
    section: Section


@dataclass(frozen=True)
class Arm:
    """One street that leads away from a crossing.

    Attributes:
        street: the street.
        station_m: station of the street at the crossing's centre, metres.
        way: 1 if the street's stations increase away from the crossing, else -1.
        minor: whether its traffic yields to the other street.
        zebra: whether a zebra crossing leads over it.
    """

    street: CrossedStreet
    station_m: float
    way: int
    minor: bool = False
    zebra: bool = False

    def at(self, out_m: float, left_m: float) -> Float64:
        """Return the point (2,) that is ``out_m`` metres out of the crossing and ``left_m`` metres to the left."""
        return self.street.line.at(self.station_m + self.way * out_m, self.way * left_m)

    def station(self, out_m: float) -> float:
        """Return the street's station at ``out_m`` metres from the crossing's centre."""
        return self.station_m + self.way * out_m

    @property
    def heading_rad(self) -> float:
        """Outward heading at the crossing's centre, radians, counter-clockwise from east."""
        return float(self.street.line.heading(self.station_m)) + (0.0 if self.way > 0 else math.pi)


@dataclass(frozen=True)
class Corner:
    """The rounded kerb between one arm and the next arm counter-clockwise.

    Attributes:
        first: index of the arm on the corner's right, seen from the crossing.
        second: index of the arm on the corner's left.
        radius_m: radius of the kerb's arc.
        centre: (2,) centre of the arc, metres.
        inner: (2,) a point inside both carriageways, towards the crossing's centre.
        first_out_m: distance out along the first arm at which the arc begins.
        second_out_m: distance out along the second arm at which the arc ends.
    """

    first: int
    second: int
    radius_m: float
    centre: Float64
    inner: Float64
    first_out_m: float
    second_out_m: float


@dataclass(frozen=True)
class Crossing:
    """A place where streets cross or join.

    Attributes:
        name: id of the crossing.
        arms: the arms, counter-clockwise.
        control: how the right of way is decided.
        first: name of the street whose traffic lights are group 0; those of the other street are group 1.
        corners: rounded corners between neighbouring arms that do not form one straight street.
        reach_m: for each arm, the distance from the centre at which the crossing ends.
    """

    name: str
    arms: tuple[Arm, ...]
    control: Control
    first: str
    corners: tuple[Corner, ...] = field(default=())
    reach_m: tuple[float, ...] = field(default=())

    def group(self, arm: int) -> int:
        """Return the signal group of the traffic that arrives on an arm, if the control is ``signal``."""
        return 0 if self.arms[arm].street.name == self.first else 1

    def patch(self, corner: Corner, beside_m: float) -> Float64:
        """Return the outline (N, 2) of the area that a corner adds to carriageways that are widened by ``beside_m``."""
        first, second = self.arms[corner.first], self.arms[corner.second]
        half, other = first.street.section.half_m, second.street.section.half_m
        start = first.at(corner.first_out_m, half + beside_m)
        end = second.at(corner.second_out_m, -other - beside_m)
        begin, stop = (scalars.atan2(*(place - corner.centre)[::-1]) for place in (start, end))
        sweep = (stop - begin + math.pi) % (2.0 * math.pi) - math.pi
        angles = begin + sweep * np.arange(1, _ARC_PIECES) / _ARC_PIECES
        arc = corner.centre + (corner.radius_m - beside_m) * np.c_[arrays.cos(angles), arrays.sin(angles)]
        return np.vstack([corner.inner, start, arc, end])


def build_crossing(name: str, arms: Sequence[Arm], control: Control, radius_m: float = 6.0) -> Crossing:
    """Build a crossing with rounded kerbs.

    Args:
        name: id of the crossing.
        arms: the arms in any order; the traffic lights of the first one's street are group 0.
        control: how the right of way is decided.
        radius_m: radius of the kerbs at the corners.

    Raises:
        UsageError: two neighbouring arms meet at an angle below 20 or above 160 degrees.
    """
    ordered = tuple(sorted(arms, key=lambda arm: arm.heading_rad % (2.0 * math.pi)))
    corners = []
    reach = [0.0] * len(ordered)
    for number, arm in enumerate(ordered):
        after = (number + 1) % len(ordered)
        other = ordered[after]
        turn = (other.heading_rad - arm.heading_rad) % (2.0 * math.pi)
        if control == "joint" or turn > _STRAIGHT_RAD:
            continue
        half, beyond = arm.street.section.half_m, other.street.section.half_m
        out, far = _intersect(arm, other, half + radius_m, beyond + radius_m)
        inside, _ = _intersect(arm, other, half - _INSIDE_M, beyond - _INSIDE_M)
        centre, inner = arm.at(out, half + radius_m), arm.at(inside, half - _INSIDE_M)
        corners.append(Corner(number, after, radius_m, centre, inner, out, far))
        reach[number], reach[after] = max(reach[number], out), max(reach[after], far)
    return Crossing(name, ordered, control, arms[0].street.name, tuple(corners), tuple(reach))


def _intersect(arm: Arm, other: Arm, left_m: float, right_m: float) -> tuple[float, float]:
    """Distances out where the line ``left_m`` left of an arm meets the line ``right_m`` right of another."""
    turn = (other.heading_rad - arm.heading_rad) % (2.0 * math.pi)
    sin, cos = scalars.sin(turn), scalars.cos(turn)
    if sin < 0.2:
        raise UsageError(
            f"{arm.street.name} and {other.street.name} meet at {math.degrees(turn):.0f} degrees",
            expected="20 to 160 degrees",
        )
    out = np.array([(right_m + left_m * cos) / sin, (left_m + right_m * cos) / sin])
    for _ in range(_TOUCHES):
        gap = arm.at(out[0], left_m) - other.at(out[1], -right_m)
        slopes = np.stack(
            [
                arm.at(out[0] + 0.5, left_m) - arm.at(out[0] - 0.5, left_m),
                other.at(out[1] - 0.5, -right_m) - other.at(out[1] + 0.5, -right_m),
            ],
            axis=1,
        )
        step = arrays.solve(slopes, gap)
        out = out - step
        if np.abs(step).max() < _EXACT_M:
            break
    return float(out[0]), float(out[1])
