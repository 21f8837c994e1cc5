"""Lots along the streets, as close as the kind of scene builds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
import shapely

from mirror.arrays import Float64
from mirror.synth.roads.crossing import Street
from mirror.synth.street.lots import Lot, LotKind

_STEP_M: Final = 1.0
_CLEAR_M: Final = 0.05
_CORNER_M: Final = 4.0
_SHARES: Final = np.linspace(0.0, 1.0, 9)


@dataclass(frozen=True)
class Building:
    """How a row of lots is built up.

    Attributes:
        kind: what belongs there.
        length_m: least and most along the street.
        depth_m: least and most.
        gap_m: least and most between lots, where they do not touch.
        touching: share of the lots that touch the next.
        set_back_m: least and most from the pavement.
        streets: on which streets, by name; none named: on all.
    """

    kind: LotKind
    length_m: tuple[float, float]
    depth_m: tuple[float, float]
    gap_m: tuple[float, float]
    touching: float
    set_back_m: tuple[float, float]
    streets: tuple[str, ...] = ()


BUILDINGS: Final[dict[str, tuple[Building, ...]]] = {
    "urban": (
        Building("front", (12.0, 24.0), (10.0, 14.0), (2.5, 6.0), 0.8, (0.1, 0.4)),
        Building("yard", (14.0, 30.0), (9.0, 13.0), (6.0, 24.0), 0.2, (24.0, 32.0)),
    ),
    "campus": (
        Building("hall", (20.0, 42.0), (12.0, 20.0), (12.0, 28.0), 0.0, (6.0, 14.0)),
        Building("yard", (18.0, 34.0), (12.0, 18.0), (16.0, 40.0), 0.0, (44.0, 60.0)),
    ),
    "rural": (
        Building("farm", (13.0, 20.0), (9.0, 12.0), (45.0, 130.0), 0.0, (7.0, 16.0), ("main", "lane")),
        Building("yard", (14.0, 24.0), (10.0, 14.0), (60.0, 160.0), 0.0, (34.0, 50.0), ("main", "lane")),
    ),
    "highway": (Building("works", (34.0, 70.0), (20.0, 34.0), (50.0, 150.0), 0.1, (26.0, 44.0)),),
}


def lay_lots(
    streets: Sequence[Street],
    taken: shapely.Geometry,
    kind: str,
    height_m: Callable[[npt.ArrayLike, npt.ArrayLike], Float64],
    rng: np.random.Generator,
) -> tuple[Lot, ...]:
    """Lots on both sides of the streets, clear of ``taken`` and of each other.

    Args:
        streets: in the order in which they are built up.
        taken: where there are roads and squares.
        kind: of scene.
        height_m: of the ground.
        rng: of what is left to chance.
    """
    shapely.prepare(taken)
    outlines: list[shapely.Geometry] = []
    lots: list[Lot] = []
    for building in BUILDINGS[kind]:
        for street in streets:
            if building.streets and street.name not in building.streets:
                continue
            for side in (1, -1):
                for lot, outline in _row(street, side, building, taken, outlines, rng):
                    lots.append(lot)
                    outlines.append(outline)
    return tuple(_standing(lot, height_m) for lot in lots)


def _standing(lot: Lot, height_m: Callable[[npt.ArrayLike, npt.ArrayLike], Float64]) -> Lot:
    x, y = lot.origin
    return replace(lot, origin=np.array([x, y, float(height_m(x, y))]))


def _row(
    street: Street,
    side: int,
    building: Building,
    taken: shapely.Geometry,
    built: Sequence[shapely.Geometry],
    rng: np.random.Generator,
) -> Iterator[tuple[Lot, shapely.Geometry]]:
    """Lots of one side of a street; whoever takes one adds its outline to ``built``."""
    at = street.line.first_m
    wish = _wish(building, rng)
    while at + wish[0] < street.line.last_m:
        length, depth, back, gap = wish
        for deep in (depth, 0.75 * depth):
            lot, outline = _lot(street, side, at, length, deep, back, building.kind)
            if not shapely.intersects(taken, outline) and not shapely.intersects(built, outline).any():
                corner = building.kind == "front" and _at_corner(street, side, at, length, taken)
                yield (replace(lot, kind="corner") if corner else lot), outline
                at += length + gap
                wish = _wish(building, rng)
                break
        else:
            at += _STEP_M


def _at_corner(street: Street, side: int, at: float, length: float, taken: shapely.Geometry) -> bool:
    """Whether another street runs beside a lot."""
    aside = street.section.half_m + street.section.pavement_m + 5.0
    beside = street.line.at(np.array([at - _CORNER_M, at + length + _CORNER_M]), side * aside)
    return bool(shapely.contains_xy(taken, beside[:, 0], beside[:, 1]).any())


def _wish(building: Building, rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Length, depth, distance from the pavement and gap to the next of a lot."""
    length, depth = rng.uniform(*building.length_m), rng.uniform(*building.depth_m)
    back, gap = rng.uniform(*building.set_back_m), rng.uniform(*building.gap_m)
    return length, depth, back, 2.0 * _CLEAR_M if rng.random() < building.touching else gap


def _lot(
    street: Street, side: int, at: float, length: float, depth: float, back: float, kind: LotKind
) -> tuple[Lot, shapely.Geometry]:
    """A lot whose front is a chord of the street's side, no point of it nearer than ``back`` to the pavement."""
    edge = street.section.half_m + street.section.pavement_m + back
    side_line = street.line.at(at + length * _SHARES, side * edge)
    first, last = side_line[0], side_line[-1]
    along = (last - first) / math.dist(first, last)
    away = side * np.array([-along[1], along[0]])
    middle = 0.5 * (first + last) + float(((side_line - first) @ away).max()) * away
    yaw = math.atan2(along[1], along[0]) + (0.0 if side > 0 else math.pi)
    lot = Lot(middle, yaw, length, depth, kind)
    return lot, lot.outline()
