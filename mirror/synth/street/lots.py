"""Where houses, lamps, trees and signs go: lots along the streets, spots on their pavements, rails beside them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely

from mirror.arrays import Float64

LotKind = Literal["front", "corner", "yard", "hall", "farm", "works"]
"""A house in a row; one at a crossing; one behind others; a building of a campus; a farm; a shed beside a motorway."""

SpotKind = Literal[
    "lamp", "tree", "sign", "furniture", "signal", "yield", "stop", "crosswalk", "bus_stop", "gantry", "exit", "pole"
]
"""A street lamp; a tree; a traffic sign (speed, parking); anything small (bench, bin, box, bollards); a traffic light;
a yield sign; a stop sign; a sign of a zebra crossing; a bus shelter; a gantry over the carriageway, with
one foot there; the sign of an exit; a pole with wires."""

RailKind = Literal["guard", "fence", "wall", "hedge"]


@dataclass(frozen=True)
class Lot:
    """Free land along a street for one house.

    A house stands with the middle of its front at ``origin``, turned by ``yaw_rad``: its own +x is to the right seen
    from the street, +y leads away from it.

    Attributes:
        origin: (3,) middle of the front edge on the ground, world metres.
        yaw_rad: turn about z, counter-clockwise.
        length_m: along the street.
        depth_m: away from it.
        kind: what belongs there.
    """

    origin: Float64
    yaw_rad: float
    length_m: float
    depth_m: float
    kind: LotKind

    def outline(self) -> shapely.Polygon:
        """Its rectangle on the ground plane."""
        along = np.array([math.cos(self.yaw_rad), math.sin(self.yaw_rad)])
        half, deep = 0.5 * self.length_m * along, self.depth_m * np.array([-along[1], along[0]])
        front = self.origin[:2]
        return shapely.Polygon([front - half, front + half, front + half + deep, front - half + deep])


@dataclass(frozen=True)
class Spot:
    """A place for one thing beside a carriageway.

    Attributes:
        place: (3,) on the ground, world metres.
        yaw_rad: direction towards the middle of the road, counter-clockwise from east.
        facing_rad: direction towards the traffic that comes on this side: what a sign's front looks to.
        kind: what belongs there.
        group: signal group of a traffic light; else None.
        reach_m: from there to the middle of the near lane: how far an arm reaches; the span of a gantry.
    """

    place: Float64
    yaw_rad: float
    facing_rad: float
    kind: SpotKind
    group: int | None = None
    reach_m: float = 3.0


@dataclass(frozen=True)
class Rail:
    """Something that runs along a street: a guard rail, a fence.

    Attributes:
        line: (N, 3) on the ground, world metres.
        kind: what it is.
    """

    line: Float64
    kind: RailKind
