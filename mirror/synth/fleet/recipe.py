"""A drive as it is wished for, and programmes of many of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from mirror.recordings.light import Light
from mirror.synth.light.condition import Weather

PoseStyle = Literal["csv", "parquet", "parts", "heading", "gps"]
"""How poses are written: one CSV or Parquet file with quaternions, several files in sequence, headings alone, or GPS
microseconds."""

CONDITIONS: Final[tuple[tuple[Light, Weather], ...]] = (
    ("day", "clear"), ("night", "clear"), ("day", "rain"), ("dusk", "clear"), ("day", "clouds"), ("night", "rain"),
)  # fmt: skip
"""Six of light and weather."""

_DATES: Final = (
    "2025-05-14", "2025-11-19", "2025-07-02", "2026-01-21", "2025-10-22", "2026-03-30", "2025-08-20", "2025-12-03",
)  # fmt: skip
_MORNINGS: Final = (False, False, True)


@dataclass(frozen=True)
class Recipe:
    """One drive as it is wished for.

    Attributes:
        route: one of `mirror.synth.driving.routes.ROUTES`.
        light: day, dusk or night.
        weather: clear, clouds or rain.
        date: local ISO date.
        vehicle: type of the vehicle, of `mirror.synth.rigs.VEHICLE_TYPES`.
        variant: where a scene has several such routes (lanes beside each other, crossings to turn at): which.
        poses: how its poses are written.
        images: whether it records images.
        morning: whether the sun stands in the east.
        lost: camera and number of an image that was lost.
    """

    route: str
    light: Light
    weather: Weather
    date: str
    vehicle: str
    variant: int = 0
    poses: PoseStyle = "csv"
    images: bool = True
    morning: bool = False
    lost: tuple[str, int] | None = None


def make_recipes(
    routes: Sequence[tuple[str, int]], vehicles: Sequence[str], count: int, first: int = 0
) -> tuple[Recipe, ...]:
    """Drives that go through routes, conditions, dates and vehicles, each in turn.

    Args:
        routes: names and variants.
        vehicles: types.
        count: how many drives.
        first: where in the conditions, dates and vehicles it begins, so that scenes differ.
    """
    found = []
    for number in range(count):
        turn = number + first
        # Every time all conditions have come, they meet other routes.
        route, variant = routes[(number + number // len(CONDITIONS)) % len(routes)]
        light, weather = CONDITIONS[turn % len(CONDITIONS)]
        found.append(
            Recipe(
                route, light, weather, _DATES[turn % len(_DATES)], vehicles[turn % len(vehicles)], variant,
                morning=_MORNINGS[turn % len(_MORNINGS)],
            )
        )  # fmt: skip
    return tuple(found)
