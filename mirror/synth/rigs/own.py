"""What a recording vehicle's cameras see of the vehicle itself: the bonnet of a car, the flanks of larger ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from mirror.synth.model import Label, Material, Model, block, extrusion
from mirror.synth.rigs.types import VehicleType

_CARS: Final[Mapping[str, tuple[float, float, float]]] = {
    "saloon": (0.05, 0.10, 0.24),
    "hatchback": (0.42, 0.03, 0.03),
    "estate": (0.16, 0.17, 0.19),
    "suv": (0.45, 0.46, 0.47),
}
_WHITE: Final = (0.78, 0.78, 0.76)
_CLEAR_M: Final = 0.35
_CAB_M: Final = 0.45


def own_model(kind: VehicleType) -> Model:
    """The parts of a vehicle that its own cameras can see, in the ego frame."""
    size = kind.size
    nose = size.length_m - size.rear_m
    if kind.name in _CARS:
        cowl, height = size.wheelbase_m - 0.5, size.height_m
        profile = [
            (cowl, 0.42 * height),
            (cowl, 0.66 * height),
            (cowl + 0.45 * (nose - cowl), 0.62 * height),
            (nose - 0.16, 0.52 * height),
            (nose - 0.02, 0.42 * height),
        ]
        return extrusion(
            profile, size.width_m - 0.1, _CARS[kind.name], Material.PAINT, Label.EGO, top_width_m=0.85 * size.width_m
        )
    front = nose - _CAB_M
    length, height = front + size.rear_m, size.height_m - _CLEAR_M
    centre = (0.5 * (front - size.rear_m), 0.0, _CLEAR_M + 0.5 * height)
    return block(centre, (length, size.width_m, height), _WHITE, Material.PAINT, Label.EGO)
