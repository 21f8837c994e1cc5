"""Houses: their walls, ground floors, roofs and windows, and what stands far off."""

from __future__ import annotations

from mirror.synth.street.houses.house import house
from mirror.synth.street.houses.styles import HouseStyle

__all__ = ["HouseStyle", "house"]
