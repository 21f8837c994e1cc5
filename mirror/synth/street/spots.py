"""Places for lamps, trees, signs and lights along the streets, and rails beside them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import shapely

from mirror.arrays import Float64
from mirror.synth.roads.crossing import CrossedStreet, Crossing
from mirror.synth.roads.ground_index import GroundIndex
from mirror.synth.roads.layouts import find_approaches
from mirror.synth.roads.relief import find_level_stretches
from mirror.synth.street.lots import Rail, RailKind, Spot, SpotKind

_KERB_SIDE_M: Final = 0.65
_CLEAR_M: Final = 4.0
_LEAST_M: Final = 0.4
_LEAST_RAIL_M: Final = 6.0
_POLE_ASIDE_M: Final = 4.5
_TREE_APART_M: Final = 3.5
_THING_APART_M: Final = 2.2
_TREE_SHARE: Final = 0.8


@dataclass(frozen=True)
class Furnishing:
    """Furnishing of the streets of a kind of scene; lengths in metres.

    Attributes:
        lamps_m: distance between lamps; 0: no lamps.
        trees_m: distance between trees; 0: no trees.
        tree_aside_m: distance of trees from the edge of the carriageway.
        things_m: distance between signs and small objects.
        aside_m: distance of lamps, signs and small objects from the edge of the carriageway.
        poles_m: distance between poles with wires, on one side of the main street; 0: no poles.
        rails: kinds of rail, and their offsets from the carriageway's outer edge, or if negative, from its inner edge.
    """

    lamps_m: float
    trees_m: float
    tree_aside_m: float
    things_m: float
    aside_m: float = 0.65
    poles_m: float = 0.0
    rails: tuple[tuple[RailKind, float], ...] = ()


FURNISHINGS: Final = {
    "urban": Furnishing(26.0, 12.0, 0.9, 9.0),
    "campus": Furnishing(24.0, 10.0, 0.9, 16.0),
    "rural": Furnishing(0.0, 19.0, 3.2, 120.0, poles_m=42.0),
    "highway": Furnishing(0.0, 30.0, 9.0, 140.0, aside_m=2.6, rails=(("guard", 0.8), ("guard", -0.7))),
}
"""The furnishing of each kind of scene."""


@dataclass(frozen=True)
class _Place:
    """A spot in the coordinates of a street."""

    street: CrossedStreet
    station_m: float
    offset_m: float
    kind: SpotKind
    group: int | None = None

    def spot(self, height: float) -> Spot:
        line, side = self.street.line, 1 if self.offset_m > 0.0 else -1
        heading = float(line.heading(self.station_m))
        where = line.at(self.station_m, self.offset_m)
        lanes = [track.offset_m for track in self.street.section.tracks if track.use == "drive"]
        near = max((side * offset for offset in lanes), default=0.0)
        reach = abs(self.offset_m) - near
        if self.kind == "gantry":
            reach = abs(self.offset_m) - self.street.section.median_m + 0.6
        return Spot(
            np.array([*where, height]), heading - side * 0.5 * math.pi, heading + (0.0 if side > 0 else math.pi),
            self.kind, self.group, reach,
        )  # fmt: skip


def place_spots(
    streets: Sequence[CrossedStreet],
    crossings: Sequence[Crossing],
    kind: str,
    taken: shapely.Geometry,
    ground_index: GroundIndex,
    rng: np.random.Generator,
) -> tuple[Spot, ...]:
    """Place spots on both sides of the streets, outside all carriageways.

    Args:
        streets: the streets, the main street first.
        crossings: the crossings.
        kind: kind of scene.
        taken: carriageways and other areas to keep free.
        ground_index: heights of the ground.
        rng: random generator.
    """
    places = [place for crossing in crossings for place in _crossing_places(crossing)]
    if kind == "highway":
        places += _gantry_places(streets[0])
    furnishing = FURNISHINGS[kind]
    for street in streets:
        street_places = _street_places(street, furnishing, rng)
        if street is streets[0] and furnishing.poles_m:
            street_places += _even_places(street, "pole", furnishing.poles_m, 1, _POLE_ASIDE_M)
        others = [other for other in streets if other is not street]
        places += _drop_on_streets(street_places, street, find_level_stretches(street, crossings), others)
    points = np.array([place.street.line.at(place.station_m, place.offset_m) for place in places])
    free = shapely.distance(taken, shapely.points(points)) > _LEAST_M
    heights = ground_index.height_m(points[:, 0], points[:, 1])
    return tuple(place.spot(float(height)) for place, height, kept in zip(places, heights, free) if kept)


def _drop_on_streets(
    places: Sequence[_Place], street: CrossedStreet, level: Float64, others: Sequence[CrossedStreet]
) -> list[_Place]:
    """The places beside a street that are outside its crossings and outside other streets, pavements and medians."""
    at = np.array([place.station_m for place in places])
    points = street.line.at(at, np.array([place.offset_m for place in places]))
    free = (at > street.line.first_m) & (at < street.line.last_m)
    free &= ~((at[:, None] > level[:, 0] - _CLEAR_M) & (at[:, None] < level[:, 1] + _CLEAR_M)).any(axis=1)
    for other in others:
        station, offset = other.line.locate(points)
        along = (station > other.line.first_m) & (station < other.line.last_m)
        free &= ~(along & (np.abs(offset) < other.section.half_m + other.section.pavement_m))
    return [place for place, kept in zip(places, free) if kept]


def _crossing_places(crossing: Crossing) -> Iterator[_Place]:
    """Yield places for lights and signs before a crossing, on the right of arriving traffic."""
    for number, approach in enumerate(find_approaches(crossing)):
        arm = approach.arm
        if approach.stop_m is None:
            continue
        station = arm.station(approach.stop_m + 0.3)
        # The right of arriving traffic is the left of the arm, seen outwards.
        offset = arm.way * (arm.street.section.half_m + _KERB_SIDE_M)
        if crossing.control == "signal":
            yield _Place(arm.street, station, offset, "signal", crossing.group(number))
        elif arm.minor:
            yield _Place(arm.street, station, offset, "yield")
        else:
            yield _Place(arm.street, station, offset, "crosswalk")


def _gantry_places(street: CrossedStreet) -> list[_Place]:
    """Places for gantries over both carriageways."""
    aside = street.section.half_m + 1.4
    length = street.line.last_m - street.line.first_m
    return [
        _Place(street, street.line.first_m + share * length, side * aside, "gantry")
        for side, share in ((-1, 0.36), (1, 0.62))
    ]


def _street_places(street: CrossedStreet, furnishing: Furnishing, rng: np.random.Generator) -> list[_Place]:
    """Lamps alternating between both sides, trees between them, and signs and small objects in the gaps."""
    places: list[_Place] = []
    for side in (1, -1):
        lamps = []
        if furnishing.lamps_m:
            lamps = _even_places(street, "lamp", furnishing.lamps_m, side, furnishing.aside_m)
        if furnishing.trees_m:
            trees = _even_places(street, "tree", furnishing.trees_m, side, furnishing.tree_aside_m, rng, 0.22)
            trees = [tree for tree in trees if _is_apart(tree, lamps, _TREE_APART_M) and rng.random() < _TREE_SHARE]
        else:
            trees = []
        things = _even_places(street, "furniture", furnishing.things_m, side, furnishing.aside_m, rng, 0.4)
        things = [thing for thing in things if _is_apart(thing, [*lamps, *trees], _THING_APART_M)]
        kinds = rng.choice(["furniture", "sign"], len(things), p=[0.7, 0.3])
        places += [*lamps, *trees, *(replace(thing, kind=kind) for thing, kind in zip(things, kinds.tolist()))]
    return places


def _even_places(
    street: CrossedStreet,
    kind: SpotKind,
    step_m: float,
    side: int,
    aside_m: float,
    rng: np.random.Generator | None = None,
    jitter: float = 0.0,
) -> list[_Place]:
    """Places every ``step_m`` along one side, shifted by half a step against the other side."""
    stations = np.arange(street.line.first_m + (0.3 if side > 0 else 0.8) * step_m, street.line.last_m, step_m)
    if rng is not None:
        stations = stations + jitter * step_m * rng.uniform(-1.0, 1.0, len(stations))
    return [_Place(street, float(at), side * (street.section.half_m + aside_m), kind) for at in stations]


def _is_apart(place: _Place, others: Sequence[_Place], least_m: float) -> bool:
    return all(abs(place.station_m - other.station_m) > least_m for other in others)


def place_rails(
    streets: Sequence[CrossedStreet], stations: Sequence[Float64], kind: str, ground_index: GroundIndex
) -> tuple[Rail, ...]:
    """Place rails along the main street, interrupted where other streets join.

    Args:
        streets: the streets, the main street first.
        stations: for each street, the stations at which its pieces end.
        kind: kind of scene.
        ground_index: heights of the ground.
    """
    main, at = streets[0], stations[0]
    others = shapely.union_all(
        [
            shapely.LineString(street.line.at(along)).buffer(street.section.half_m + street.section.pavement_m)
            for street, along in zip(streets[1:], stations[1:])
        ]
    )
    rails = []
    for rail, aside in FURNISHINGS[kind].rails:
        offset = main.section.half_m + aside if aside > 0.0 else main.section.median_m + aside
        for side in (1, -1):
            line = shapely.LineString(main.line.at(at, side * offset))
            for part in shapely.get_parts(shapely.difference(line, others)):
                if part.length > _LEAST_RAIL_M:
                    points = shapely.get_coordinates(part)
                    rails.append(Rail(np.c_[points, ground_index.height_m(points[:, 0], points[:, 1])], rail))
    return tuple(rails)
