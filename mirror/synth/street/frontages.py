"""Places lots along the streets, as densely as the kind of scene requires."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
import shapely

from mirror.arrays import Float64
from mirror.portable import arrays, scalars
from mirror.synth.roads.crossing import CrossedStreet
from mirror.synth.street.lots import Lot, LotKind

_GRID_M: Final = 0.5
_STEP: Final = 3
_COARSE: Final = 4
_CORNER: Final = 8
_CLEAR_M: Final = 0.04
_LEAST_SHARE: Final = 0.75


@dataclass(frozen=True)
class Building:
    """Rules for a row of lots.

    Attributes:
        kind: kind of lot.
        length_m: smallest and largest length along the street.
        depth_m: smallest and largest depth.
        gap_m: smallest and largest gap between lots that do not touch.
        touching: share of the lots that touch the next one.
        set_back_m: smallest and largest distance from the pavement.
        streets: names of the streets that the row is built on; empty: all streets.
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


def place_lots(
    streets: Sequence[CrossedStreet],
    taken: shapely.Geometry,
    kind: str,
    height_m: Callable[[npt.ArrayLike, npt.ArrayLike], Float64],
    rng: np.random.Generator,
) -> tuple[Lot, ...]:
    """Place lots on both sides of the streets, clear of ``taken`` and of each other.

    Args:
        streets: the streets, in the order in which lots are placed.
        taken: area of roads and squares.
        kind: kind of scene.
        height_m: height of the ground as a function of x and y.
        rng: random generator.
    """
    shapely.prepare(taken)
    outlines: list[shapely.Geometry] = []
    lots: list[Lot] = []
    for building in BUILDINGS[kind]:
        for street in streets:
            if building.streets and street.name not in building.streets:
                continue
            for side in (1, -1):
                for lot, outline in _build_row(_sample_side(street, side), building, taken, outlines, rng):
                    lots.append(lot)
                    outlines.append(outline)
    return tuple(_place_on_ground(lot, height_m) for lot in lots)


def _place_on_ground(lot: Lot, height_m: Callable[[npt.ArrayLike, npt.ArrayLike], Float64]) -> Lot:
    x, y = lot.origin
    return replace(lot, origin=np.array([x, y, float(height_m(x, y))]))


@dataclass(frozen=True)
class _Side:
    """One side of a street, sampled every ``_GRID_M`` of its stations.

    Attributes:
        middle: (N, 2) points of the street's middle line.
        away: (N, 2) unit directions from the middle line to this side.
        edge_m: distance of the pavement's outer edge from the middle line.
        side: 1 for the left side, -1 for the right side.
    """

    middle: Float64
    away: Float64
    edge_m: float
    side: int

    def at(self, index: int, aside_m: float) -> Float64:
        """The point (2,) at a distance from the street's middle."""
        return self.middle[index] + aside_m * self.away[index]

    def lot(self, first: int, last: int, depth: float, back: float, kind: LotKind) -> Lot:
        """A lot along a chord of the street's side; every point of it is at least ``back`` from the pavement."""
        front = self.middle[first : last + 1 : _COARSE] + (self.edge_m + back) * self.away[first : last + 1 : _COARSE]
        length = math.dist(front[0], front[-1])
        along = (front[-1] - front[0]) / length
        away = self.side * np.array([-along[1], along[0]])
        bulge = float((arrays.matmul((front - front[0]), away)).max())
        yaw = scalars.atan2(along[1], along[0]) + (0.0 if self.side > 0 else math.pi)
        return Lot(0.5 * (front[0] + front[-1]) + bulge * away, yaw, length - 2.0 * _CLEAR_M, depth, kind)


def _sample_side(street: CrossedStreet, side: int) -> _Side:
    stations = np.arange(street.line.first_m, street.line.last_m, _GRID_M)
    middle, beside = street.line.at(stations), street.line.at(stations, float(side))
    return _Side(middle, beside - middle, street.section.half_m + street.section.pavement_m, side)


def _build_row(
    beside: _Side,
    building: Building,
    taken: shapely.Geometry,
    built: Sequence[shapely.Geometry],
    rng: np.random.Generator,
) -> Iterator[tuple[Lot, shapely.Geometry]]:
    """Yield lots for one side of a street; the caller appends accepted outlines to ``built``."""
    at, (count, depth, back, gap) = 0, _draw_lot(building, rng)
    while at + count < len(beside.middle):
        for lot_depth in (depth, 0.75 * depth):
            lot = beside.lot(at, at + count, lot_depth, back, building.kind)
            if lot.length_m < _LEAST_SHARE * building.length_m[0]:
                continue
            outline = lot.outline()
            if not shapely.intersects(taken, outline) and not shapely.intersects(built, outline).any():
                if building.kind == "front" and _is_at_corner(beside, at, at + count, taken):
                    lot = replace(lot, kind="corner")
                yield lot, outline
                at += count + gap
                count, depth, back, gap = _draw_lot(building, rng)
                break
        else:
            at += _STEP


def _is_at_corner(beside: _Side, first: int, last: int, taken: shapely.Geometry) -> bool:
    """Return whether another street runs beside a lot."""
    places = np.array(
        [
            beside.at(max(first - _CORNER, 0), beside.edge_m + 5.0),
            beside.at(min(last + _CORNER, len(beside.middle) - 1), beside.edge_m + 5.0),
        ]
    )
    return bool(shapely.contains_xy(taken, places[:, 0], places[:, 1]).any())


def _draw_lot(building: Building, rng: np.random.Generator) -> tuple[int, float, float, int]:
    """Draw length, depth, distance from the pavement and gap of a lot; length and gap are counted in grid steps."""
    length, depth = rng.uniform(*building.length_m), rng.uniform(*building.depth_m)
    back, gap = rng.uniform(*building.set_back_m), rng.uniform(*building.gap_m)
    gap = 0.0 if rng.random() < building.touching else gap
    return _COARSE * round(length / (_COARSE * _GRID_M)), depth, back, round(gap / _GRID_M)
