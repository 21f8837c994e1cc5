"""The classes of the semantic masks."""

from __future__ import annotations

from enum import IntEnum


class Label(IntEnum):
    """Class of a surface in semantic masks, as an 8-bit value."""

    SKY = 0
    ROAD = 1
    PAVEMENT = 2
    TERRAIN = 3
    BUILDING = 4
    WALL = 5
    POLE = 6
    TRAFFIC_LIGHT = 7
    TRAFFIC_SIGN = 8
    VEGETATION = 9
    BILLBOARD = 10
    FURNITURE = 11
    PERSON = 12
    RIDER = 13
    CAR = 14
    VAN = 15
    TRUCK = 16
    BUS = 17
    MOTORCYCLE = 18
    BICYCLE = 19
    EGO = 20
