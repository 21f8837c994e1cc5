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
class Mount:
    """Where the end of a vehicle may carry a plate, above the ground and to both sides of the middle.

    Attributes:
        low_m: height of the lower edge of the lowest plate.
        high_m: height of the upper edge of the highest plate.
        half_width_m: half the width of the plate, with a margin for frames and for plates beside the middle.
    """

    low_m: float
    high_m: float
    half_width_m: float = 0.31


_REAR: Final = Mount(0.30, 1.20)
"""Regulation (EU) No 1003/2010, annex II: from 0.30 to 1.20 m. For front plates no heights are laid down."""
_FRONT: Final = Mount(0.30, 0.80)
_HEAVY_FRONT: Final = Mount(0.30, 1.05)
_MOTORCYCLE: Final = Mount(0.30, 1.20, 0.20)


def find_mount(category: str, *, is_front: bool) -> Mount | None:
    """Where the front or the rear of a vehicle carries its plate.

    Args:
        category: category of the box.
        is_front: the front, and not the rear.

    Returns:
        The place; None: it carries none. Trailers and motorcycles have none at the front.
    """
    if not is_vehicle(category):
        return None
    words = category_words(category)
    if "motorcycle" in words:
        return None if is_front else _MOTORCYCLE
    if not is_front:
        return _REAR
    if "trailer" in words:
        return None
    return _HEAVY_FRONT if words & _HEAVY else _FRONT


def is_vehicle(category: str) -> bool:
    """Whether objects of a category carry number plates."""
    return category.lower() in VEHICLES or bool(category_words(category) & VEHICLES)


def category_words(category: str) -> frozenset[str]:
    """The words of a category, such as `vehicle` and `car` of ``vehicle.car``."""
    return frozenset(category.lower().replace(".", "_").replace(" ", "_").replace("-", "_").split("_"))
