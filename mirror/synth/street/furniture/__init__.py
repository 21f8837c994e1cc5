"""Street furniture: lamps, signals, signs, seats, fences.

Each model stands in its own frame with its foot at the origin and its front towards +x. Posts extend below the ground,
because the ground may slope.
"""

from __future__ import annotations

from mirror.synth.street.furniture.advertising import (
    advertising_column,
    billboard,
    bus_shelter,
    city_light,
    high_billboard,
)
from mirror.synth.street.furniture.lamps import LampKind, LampPost, lamp_post
from mirror.synth.street.furniture.rails import fence, garden_wall, guard_rail, power_line
from mirror.synth.street.furniture.signals import SignalHead, traffic_light
from mirror.synth.street.furniture.signs import direction_sign, gantry, traffic_sign
from mirror.synth.street.furniture.small import (
    PARK,
    PAVEMENT,
    ROADSIDE,
    bench,
    bicycle_stands,
    bin_,
    bollards,
    cafe_table,
    electrical_box,
    planter,
)

__all__ = [
    "PARK",
    "PAVEMENT",
    "ROADSIDE",
    "LampKind",
    "LampPost",
    "SignalHead",
    "advertising_column",
    "bench",
    "bicycle_stands",
    "billboard",
    "bin_",
    "bollards",
    "bus_shelter",
    "cafe_table",
    "city_light",
    "direction_sign",
    "electrical_box",
    "fence",
    "gantry",
    "garden_wall",
    "guard_rail",
    "high_billboard",
    "lamp_post",
    "planter",
    "power_line",
    "traffic_light",
    "traffic_sign",
]
