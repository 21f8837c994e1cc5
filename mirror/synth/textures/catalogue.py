"""The catalogue of images and grains: models refer to them by number, and the atlas contains them."""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class Grain(IntEnum):
    """A periodic grey pattern with mean 1 that multiplies the reflectance of a surface."""

    ASPHALT = 0
    PAVING = 1
    BRICK = 2
    PLASTER = 3
    CONCRETE = 4
    GRASS = 5
    GRAVEL = 6
    ROOF = 7
    WOOD = 8
    BARK = 9
    LEAVES = 10
    CLOTH = 11
    METAL = 12
    STAINS = 13
    """Large soft patches of dirt, applied on top of other grains."""


PERIOD_M: Final[dict[Grain, float]] = {
    Grain.ASPHALT: 2.0,
    Grain.PAVING: 2.4,
    Grain.BRICK: 2.08,
    Grain.PLASTER: 3.0,
    Grain.CONCRETE: 4.0,
    Grain.GRASS: 3.0,
    Grain.GRAVEL: 2.0,
    Grain.ROOF: 2.4,
    Grain.WOOD: 1.5,
    Grain.BARK: 1.0,
    Grain.LEAVES: 1.2,
    Grain.CLOTH: 0.5,
    Grain.METAL: 2.0,
    Grain.STAINS: 23.0,
}
"""Period of each grain, metres."""

SHOP_SIGNS: Final = range(0, 40)
"""Shop signs with an aspect of 5:1."""
BILLBOARDS: Final = range(40, 56)
"""Advertisements with an aspect of 3:2."""
POSTERS: Final = range(56, 72)
"""Posters with an aspect of 2:3."""
TRAFFIC_SIGNS: Final = range(72, 92)
"""Square images of traffic signs; grey outside a round or triangular sign."""


class Sign(IntEnum):
    """The meaning of each image of :data:`TRAFFIC_SIGNS`."""

    SPEED_30 = 72
    SPEED_50 = 73
    SPEED_80 = 74
    SPEED_120 = 75
    NO_ENTRY = 76
    YIELD = 77
    """A triangle with its tip at the bottom."""
    STOP = 78
    """An octagon."""
    PRIORITY = 79
    """A square with a corner at the bottom."""
    PARKING = 80
    NO_PARKING = 81
    CROSSWALK = 82
    CYCLE_PATH = 83
    BUS_STOP = 84
    ONE_WAY = 85
    KEEP_RIGHT = 86
    BEND = 87
    """A triangle with its tip at the top; so are the following signs."""
    CHILDREN = 88
    ROADWORKS = 89
    CROSSING_AHEAD = 90
    ROUNDABOUT = 91


DIRECTION_SIGNS: Final = range(92, 100)
"""Direction signs with an aspect of 2:1."""
SHOP_WINDOWS: Final = range(100, 124)
"""Interiors behind shop windows, with an aspect of 3:2."""
DOORS: Final = range(124, 132)
"""Doors with an aspect of 1:2."""
GRAFFITI: Final = range(132, 140)
"""Graffiti on a plain wall, with an aspect of 2:1."""
LIVERIES: Final = range(140, 156)
"""Sides of vans, trucks and buses, with an aspect of 2:1."""
FACES: Final = range(156, 188)
"""Square images of faces: the front half of a head, with the face in the middle."""
PLATES: Final = range(188, 444)
"""Number plates with an aspect of 52:11."""
COUNT: Final = 444
