"""Which images and which grains there are: builders of models name them by number, the atlas holds them."""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class Grain(IntEnum):
    """A grey pattern that repeats, with a mean of 1: reflectance is multiplied by it."""

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
    """Large, soft: dirt and weather, on top of all the others."""


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
"""Metres after which each repeats."""

SHOP_SIGNS: Final = range(0, 40)
"""Names of shops, 5 wide to 1 high."""
BILLBOARDS: Final = range(40, 56)
"""Advertisements, 3 wide to 2 high."""
POSTERS: Final = range(56, 72)
"""2 wide to 3 high."""
TRAFFIC_SIGNS: Final = range(72, 92)
"""Square images; outside a round or three-cornered sign they are grey, its back shows there."""


class Sign(IntEnum):
    """Which image of :data:`TRAFFIC_SIGNS` says what."""

    SPEED_30 = 72
    SPEED_50 = 73
    SPEED_80 = 74
    SPEED_120 = 75
    NO_ENTRY = 76
    YIELD = 77
    """A triangle that stands on its tip."""
    STOP = 78
    """An octagon."""
    PRIORITY = 79
    """A square that stands on its tip."""
    PARKING = 80
    NO_PARKING = 81
    CROSSWALK = 82
    CYCLE_PATH = 83
    BUS_STOP = 84
    ONE_WAY = 85
    KEEP_RIGHT = 86
    BEND = 87
    """A triangle that stands on its side, as the next ones."""
    CHILDREN = 88
    ROADWORKS = 89
    CROSSING_AHEAD = 90
    ROUNDABOUT = 91


DIRECTION_SIGNS: Final = range(92, 100)
"""Over roads, 2 wide to 1 high."""
SHOP_WINDOWS: Final = range(100, 124)
"""What lies behind shop windows, 3 wide to 2 high."""
DOORS: Final = range(124, 132)
"""1 wide to 2 high."""
GRAFFITI: Final = range(132, 140)
"""2 wide to 1 high, on a plain wall."""
LIVERIES: Final = range(140, 156)
"""Sides of vans, trucks and buses, 2 wide to 1 high."""
FACES: Final = range(156, 188)
"""Of people, square: the front half of a head, the face in the middle."""
PLATES: Final = range(188, 444)
"""Number plates, 52 wide to 11 high."""
COUNT: Final = 444
