"""Where streets meet: which arms there are, how their kerbs are rounded, and how far the crossing reaches into each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.synth.roads.line import Line
from mirror.synth.roads.section import Section

Control = Literal["signal", "priority", "joint"]
"""Traffic lights; who goes first is said by signs; nothing crosses, a lane only branches off."""

_STRAIGHT_RAD: Final = math.radians(150.0)
_ARC_PIECES: Final = 6
_TOUCHES: Final = 12
_EXACT_M: Final = 1e-9
_INSIDE_M: Final = 1.0


@dataclass(frozen=True)
class Street:
    """A street.

    Attributes:
        name: its id.
        line: its middle.
        section: its cross-section.
    """

    name: str
    line: Line
    section: Section


@dataclass(frozen=True)
class Arm:
    """A street on its way out of a crossing.

    Attributes:
        street: the street.
        station_m: where it passes the crossing's middle.
        way: 1 where its stations grow outwards, else -1.
        minor: whether it yields.
        zebra: whether one crosses it on foot.
    """

    street: Street
    station_m: float
    way: int
    minor: bool = False
    zebra: bool = False

    def at(self, out_m: float, left_m: float) -> Float64:
        """The point (2,) so far out and so far left, seen outwards."""
        return self.street.line.at(self.station_m + self.way * out_m, self.way * left_m)

    def station(self, out_m: float) -> float:
        """Station of the street so far out."""
        return self.station_m + self.way * out_m

    @property
    def heading_rad(self) -> float:
        """Outwards."""
        return float(self.street.line.heading(self.station_m)) + (0.0 if self.way > 0 else math.pi)


@dataclass(frozen=True)
class Corner:
    """The rounded kerb between an arm and the next one counter-clockwise.

    Attributes:
        first: number of the arm to its right, seen from the crossing.
        second: number of the arm to its left.
        radius_m: of the kerb.
        centre: (2,) of its arc.
        inner: (2,) a place within both carriageways, behind the corner.
        first_out_m: where the arc leaves the first arm's kerb.
        second_out_m: where it meets the second's.
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
    """A place where streets meet.

    Attributes:
        name: its id.
        arms: counter-clockwise.
        control: who goes first.
        first: name of the street whose traffic lights are group 0; the others' are group 1.
        corners: between arms that do not go straight on.
        reach_m: by arm, how far the crossing reaches into it.
    """

    name: str
    arms: tuple[Arm, ...]
    control: Control
    first: str
    corners: tuple[Corner, ...] = field(default=())
    reach_m: tuple[float, ...] = field(default=())

    def group(self, arm: int) -> int:
        """The signal group of those who come on an arm, where there are traffic lights."""
        return 0 if self.arms[arm].street.name == self.first else 1

    def patch(self, corner: Corner, beside_m: float) -> Float64:
        """Outline (N, 2) of what a corner adds to carriageways that are widened by ``beside_m``."""
        first, second = self.arms[corner.first], self.arms[corner.second]
        half, other = first.street.section.half_m, second.street.section.half_m
        start = first.at(corner.first_out_m, half + beside_m)
        end = second.at(corner.second_out_m, -other - beside_m)
        begin, stop = (math.atan2(*(place - corner.centre)[::-1]) for place in (start, end))
        sweep = (stop - begin + math.pi) % (2.0 * math.pi) - math.pi
        angles = begin + sweep * np.arange(1, _ARC_PIECES) / _ARC_PIECES
        arc = corner.centre + (corner.radius_m - beside_m) * np.c_[np.cos(angles), np.sin(angles)]
        return np.vstack([corner.inner, start, arc, end])


def crossing(name: str, arms: Sequence[Arm], control: Control, radius_m: float = 6.0) -> Crossing:
    """A crossing with rounded kerbs.

    Args:
        name: its id.
        arms: in any order; the first is of the street whose traffic lights are group 0.
        control: who goes first.
        radius_m: of the kerbs at its corners.

    Raises:
        UsageError: two arms run so close that there is no corner between them.
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
        out, far = _meeting(arm, other, half + radius_m, beyond + radius_m)
        inside, _ = _meeting(arm, other, half - _INSIDE_M, beyond - _INSIDE_M)
        centre, inner = arm.at(out, half + radius_m), arm.at(inside, half - _INSIDE_M)
        corners.append(Corner(number, after, radius_m, centre, inner, out, far))
        reach[number], reach[after] = max(reach[number], out), max(reach[after], far)
    return Crossing(name, ordered, control, arms[0].street.name, tuple(corners), tuple(reach))


def _meeting(arm: Arm, other: Arm, left_m: float, right_m: float) -> tuple[float, float]:
    """How far out the line left of an arm and the line right of another meet, by Newton's steps."""
    turn = (other.heading_rad - arm.heading_rad) % (2.0 * math.pi)
    sin, cos = math.sin(turn), math.cos(turn)
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
        step = np.linalg.solve(slopes, gap)
        out = out - step
        if np.abs(step).max() < _EXACT_M:
            break
    return float(out[0]), float(out[1])
