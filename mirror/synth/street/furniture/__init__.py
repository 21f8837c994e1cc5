"""What stands along streets: lamps, signals, signs, seats, fences.

All of it stands in its own frame with its foot at the origin and looks to +x; feet go down into the ground, which may
slope.
"""

from __future__ import annotations

from mirror.synth.street.furniture.advertising import advertising_column, billboard, bus_shelter, city_light
from mirror.synth.street.furniture.lamps import LampKind, LampPost, lamp_post
from mirror.synth.street.furniture.rails import fence, garden_wall, guard_rail, power_line
from mirror.synth.street.furniture.signals import SignalHead, traffic_light
from mirror.synth.street.furniture.signs import direction_sign, gantry, traffic_sign
from mirror.synth.street.furniture.small import PARK, PAVEMENT, ROADSIDE, cafe_table

__all__ = [
    "PARK",
    "PAVEMENT",
    "ROADSIDE",
    "LampKind",
    "LampPost",
    "SignalHead",
    "advertising_column",
    "billboard",
    "bus_shelter",
    "cafe_table",
    "city_light",
    "direction_sign",
    "fence",
    "gantry",
    "garden_wall",
    "guard_rail",
    "lamp_post",
    "power_line",
    "traffic_light",
    "traffic_sign",
]
