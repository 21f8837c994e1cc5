"""Houses: walls, ground floors, roofs and windows, and the distant skyline."""

from __future__ import annotations

from mirror.synth.street.houses.house import house
from mirror.synth.street.houses.skyline import far_houses, far_woods
from mirror.synth.street.houses.styles import HouseStyle

__all__ = ["HouseStyle", "far_houses", "far_woods", "house"]
