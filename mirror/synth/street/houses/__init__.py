"""Houses: walls, ground floors, roofs and windows, and the distant skyline."""

from __future__ import annotations

from mirror.synth.street.houses.house import build_house
from mirror.synth.street.houses.skyline import build_far_houses, build_far_woods
from mirror.synth.street.houses.styles import HouseStyle

__all__ = ["HouseStyle", "build_far_houses", "build_far_woods", "build_house"]
