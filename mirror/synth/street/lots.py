"""Places for houses and furniture: lots along the streets, spots on their pavements, rails beside them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely

from mirror.arrays import Float64
from mirror.portable import scalars

LotKind = Literal["front", "corner", "yard", "hall", "farm", "works"]
"""A row house; a house at a crossing; a house behind others; a campus building; a farm; a motorway shed."""

SpotKind = Literal[
    "lamp", "tree", "sign", "furniture", "signal", "yield", "stop", "crosswalk", "bus_stop", "gantry", "exit", "pole"
]
"""A street lamp; a tree; a traffic sign (speed, parking); small furniture (bench, bin, box, bollards); a traffic light;
a yield sign; a stop sign; a zebra crossing's sign; a bus shelter; a gantry over the carriageway with one foot here;
a motorway exit's sign; a pole with wires."""

RailKind = Literal["guard", "fence", "wall", "hedge"]


@dataclass(frozen=True)
class Lot:
    """A piece of land along a street for one house.

    A house stands with the middle of its front at ``origin``, rotated by ``yaw_rad``: its own +x axis points right as
    seen from the street, and its +y axis points away from the street.

    Attributes:
        origin: (3,) middle of the front edge on the ground, world frame, metres.
        yaw_rad: rotation about z, counter-clockwise.
        length_m: extent along the street.
        depth_m: extent away from the street.
        kind: kind of lot.
    """

    origin: Float64
    yaw_rad: float
    length_m: float
    depth_m: float
    kind: LotKind

    def outline(self) -> shapely.Polygon:
        """Return the lot's rectangle on the ground plane."""
        along = np.array([scalars.cos(self.yaw_rad), scalars.sin(self.yaw_rad)])
        half, deep = 0.5 * self.length_m * along, self.depth_m * np.array([-along[1], along[0]])
        front = self.origin[:2]
        return shapely.Polygon([front - half, front + half, front + half + deep, front - half + deep])


@dataclass(frozen=True)
class Spot:
    """A place for one object beside a carriageway.

    Attributes:
        place: (3,) position on the ground, world frame, metres.
        yaw_rad: direction towards the middle of the road, counter-clockwise from east.
        facing_rad: direction towards oncoming traffic on this side, which the front of a sign faces.
        kind: kind of object.
        group: signal group of a traffic light; otherwise None.
        reach_m: distance to the middle of the nearest lane, which limits the length of an arm; for a gantry, its span.
    """

    place: Float64
    yaw_rad: float
    facing_rad: float
    kind: SpotKind
    group: int | None = None
    reach_m: float = 3.0


@dataclass(frozen=True)
class Rail:
    """An object that runs along a street, such as a guard rail or a fence.

    Attributes:
        line: (N, 3) points on the ground, world frame, metres.
        kind: kind of rail.
    """

    line: Float64
    kind: RailKind
