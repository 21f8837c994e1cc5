"""Where vehicles of a category carry number plates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

VEHICLES: Final = frozenset(
    ("car", "van", "truck", "bus", "trailer", "vehicle", "motorcycle", "construction_vehicle", "pickup", "taxi")
)
"""Categories of boxes that carry number plates; other categories are recognised by their words."""
_HEAVY: Final = frozenset(("truck", "bus", "trailer", "construction"))


@dataclass(frozen=True)
class PlateMount:
    """The places where the end of a vehicle may carry a plate: heights, and offsets to both sides of the middle.

    Attributes:
        low_m: height of the lower edge of the lowest plate.
        high_m: height of the upper edge of the highest plate.
        half_width_m: half the width of the plate, with a margin for frames and for plates beside the middle.
    """

    low_m: float
    high_m: float
    half_width_m: float = 0.31


_TALL_M: Final = 1.6
"""Height of a box from which a car is a sport utility vehicle, a pickup or a van: its plates are mounted higher."""
_REAR, _FRONT = PlateMount(0.35, 1.05), PlateMount(0.30, 0.70)
"""Cars: from the rear bumper to the handle of the tailgate; the front bumper."""
_TALL_REAR, _TALL_FRONT = PlateMount(0.35, 1.20), PlateMount(0.30, 0.85)
_HEAVY_REAR, _HEAVY_FRONT = PlateMount(0.30, 1.20), PlateMount(0.30, 1.05)
_MOTORCYCLE: Final = PlateMount(0.30, 1.20, 0.20)
"""Regulation (EU) No 1003/2010, annex II: rear plates are mounted from 0.30 to 1.20 m. Front plates have no rule."""


def find_mount(category: str, height_m: float, *, is_front: bool) -> PlateMount | None:
    """Find where the front or the rear of a vehicle carries its plate.

    Args:
        category: category of the box.
        height_m: height of the box.
        is_front: the front, and not the rear.

    Returns:
        The place; None: it carries none. Trailers and motorcycles have none at the front.
    """
    words = category_words(category)
    if not is_vehicle(category) or (is_front and words & {"motorcycle", "trailer"}):
        return None
    if "motorcycle" in words:
        return _MOTORCYCLE
    if words & _HEAVY:
        return _HEAVY_FRONT if is_front else _HEAVY_REAR
    if height_m > _TALL_M:
        return _TALL_FRONT if is_front else _TALL_REAR
    return _FRONT if is_front else _REAR


def is_vehicle(category: str) -> bool:
    """Return whether objects of a category carry number plates."""
    return category.lower() in VEHICLES or bool(category_words(category) & VEHICLES)


def category_words(category: str) -> frozenset[str]:
    """Return the words of a category, such as `vehicle` and `car` of ``vehicle.car``."""
    return frozenset(category.lower().replace(".", "_").replace(" ", "_").replace("-", "_").split("_"))
