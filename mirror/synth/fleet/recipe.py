"""Specifications of drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from mirror.recordings.light import Light
from mirror.synth.light.condition import Weather

PoseStyle = Literal["csv", "parquet", "parts", "heading", "gps"]
"""Layout of the poses: one CSV or Parquet file with quaternions, several files in sequence, a file with headings in
place of quaternions, or a file with GPS microseconds."""

CONDITIONS: Final[tuple[tuple[Light, Weather], ...]] = (
    ("day", "clear"), ("night", "clear"), ("day", "rain"), ("dusk", "clear"), ("day", "clouds"), ("night", "rain"),
)  # fmt: skip
"""Six combinations of light and weather."""

_DATES: Final = (
    "2025-05-14", "2025-11-19", "2025-07-02", "2026-01-21", "2025-10-22", "2026-03-30", "2025-08-20", "2025-12-03",
)  # fmt: skip
_MORNINGS: Final = (False, False, True)


@dataclass(frozen=True)
class Recipe:
    """The specification of one drive.

    Attributes:
        route: one of `mirror.synth.driving.routes.ROUTES`.
        light: day, dusk or night.
        weather: clear, clouds or rain.
        date: local ISO date.
        vehicle: one of `mirror.synth.rigs.VEHICLE_TYPES`.
        variant: index among the routes of that name, where a scene has several (parallel lanes, several crossings).
        poses: layout of the poses.
        images: whether the drive records images.
        morning: True: the drive is before noon; False: after noon.
        lost: camera and index of an image that is lost; None: no image is lost.
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
    """Make recipes that cycle through routes, conditions, dates and vehicles.

    Args:
        routes: names and variants of the routes.
        vehicles: vehicle types.
        count: number of recipes.
        first: index at which the conditions, dates and vehicles begin, so that scenes differ.
    """
    recipes = []
    for number in range(count):
        turn = number + first
        # After each full cycle of conditions, the routes shift by one, so that all combinations occur.
        route, variant = routes[(number + number // len(CONDITIONS)) % len(routes)]
        light, weather = CONDITIONS[turn % len(CONDITIONS)]
        recipes.append(
            Recipe(
                route, light, weather, _DATES[turn % len(_DATES)], vehicles[turn % len(vehicles)], variant,
                morning=_MORNINGS[turn % len(_MORNINGS)],
            )
        )  # fmt: skip
    return tuple(recipes)
