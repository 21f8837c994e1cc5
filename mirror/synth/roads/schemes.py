"""Street plans of the four kinds of scene."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from mirror.arrays import Float64
from mirror.portable import arrays, scalars
from mirror.synth.model import Label, Material
from mirror.synth.roads.crossing import Arm, CrossedStreet, Crossing, build_crossing
from mirror.synth.roads.ground import Cover
from mirror.synth.roads.line import Bend, Line, build_line
from mirror.synth.roads.section import (
    CAMPUS_STREET,
    COUNTRY_ROAD,
    CYCLE_STREET,
    FARM_TRACK,
    MAIN_STREET,
    MOTORWAY,
    OUTER_STREET,
    SIDE_STREET,
    SLIP_ROAD,
    Section,
)

BEYOND_M: Final = 90.0
"""Length by which streets continue outside the ROI."""
EDGE: Final = 0.975
"""Distance of the outermost cross street from the ROI's centre, as a share of the ROI's radius."""
_SLIP_RAD: Final = 0.30
"""Angle at which slip roads leave a motorway."""

GRASS: Final = (0.085, 0.125, 0.040)
_MEADOW: Final = (0.110, 0.150, 0.048)
_STUBBLE: Final = (0.240, 0.200, 0.110)
_SOIL: Final = (0.125, 0.092, 0.064)
_CROP: Final = (0.070, 0.115, 0.034)
_SLABS: Final = (0.300, 0.293, 0.280)
_YARD: Final = (0.215, 0.208, 0.195)
_DIRT: Final = (0.260, 0.225, 0.180)
_NOWHERE: Final = shapely.Polygon()


@dataclass(frozen=True)
class Scheme:
    """The street plan of a kind of scene.

    Attributes:
        streets: the main street first; where streets overlap, the earlier one determines the surface.
        crossings: the crossings.
        kerb_m: height of the kerbs.
        slope: slope of the land as a whole.
        steepest: upper bound of the slope of the land's waves.
        pavement: cover beside the carriageways.
        forecourt_m: width of the same cover between the pavements and the houses.
        covers: covers of outlined parts of the land.
        parcels: covers of the remaining land; one that is listed twice is twice as frequent.
        bridge_m: station of the main street at which a bridge leads over it; None if there is no bridge.
    """

    streets: tuple[CrossedStreet, ...]
    crossings: tuple[Crossing, ...]
    kerb_m: float
    slope: float
    steepest: float
    pavement: Cover
    forecourt_m: float
    covers: tuple[Cover, ...]
    parcels: tuple[Cover, ...]
    bridge_m: float | None = None


def _bend_angle(length_m: float, least_radius_m: float, most_rad: float) -> float:
    """The largest change of heading of a bend of a given length and least radius, at most ``most_rad``."""
    return min(most_rad, length_m / (2.0 * least_radius_m))


def _straight_arms(
    street: CrossedStreet, station: float, *, zebra: bool = False, minor: bool = False
) -> tuple[Arm, Arm]:
    return Arm(street, station, 1, minor, zebra), Arm(street, station, -1, minor, zebra)


def _edge_street(main: Line, radius: float, section: Section, extent: float) -> tuple[CrossedStreet, float]:
    """A straight street across the main street, at a distance of ``EDGE`` times the radius from the ROI's centre."""
    stations = np.arange(main.first_m, -0.5 * radius, 0.25)
    headings, points = main.heading(stations), main.at(stations)
    distance = -(points[:, 0] * arrays.cos(headings) + points[:, 1] * arrays.sin(headings))
    station = float(stations[int(np.argmin(np.abs(distance - EDGE * radius)))])
    line = build_line(main.at(station), float(main.heading(station)) + 0.5 * math.pi, -2.0 * extent, 2.0 * extent)
    return CrossedStreet("edge", line.until(extent), section), station


def _cross_street(
    name: str, main: Line, station: float, turn: float, section: Section, extent: float, bends: tuple[Bend, ...] = ()
) -> CrossedStreet:
    """A street that crosses the main street at an angle of ``turn``."""
    line = build_line(main.at(station), float(main.heading(station)) + turn, -2.0 * extent, 2.0 * extent, bends)
    return CrossedStreet(name, line.until(extent), section)


def _branch_street(
    name: str, main: Line, station: float, turn: float, section: Section, extent: float, bends: tuple[Bend, ...] = ()
) -> CrossedStreet:
    """A street that begins at the main street's middle."""
    line = build_line(main.at(station), float(main.heading(station)) + turn, 0.0, 2.0 * extent, bends)
    far = arrays.hypot(*line.points.T) > extent
    stop = int(np.argmax(far)) if far.any() else len(far)
    part = Line(0.0, float(line.stations[stop - 1]), line.stations[:stop], line.points[:stop], line.headings[:stop])
    return CrossedStreet(name, part, section)


def _land_cover(material: Material, label: Label, colour: tuple[float, float, float]) -> Cover:
    return Cover(_NOWHERE, material, label, colour)


def _paved_cover(colour: tuple[float, float, float] = _SLABS) -> Cover:
    return _land_cover(Material.PAVING, Label.PAVEMENT, colour)


def _urban_scheme(radius: float, yaw: float, rng: np.random.Generator) -> Scheme:
    extent = radius + BEYOND_M
    side = float(rng.choice((-1.0, 1.0)))
    first, second = 0.60 * radius, 0.50 * radius
    bends = (
        Bend(-0.32 * radius, first, side * _bend_angle(first, 60.0, rng.uniform(0.42, 0.55))),
        Bend(0.66 * radius, second, -side * _bend_angle(second, 60.0, rng.uniform(0.30, 0.42))),
    )
    place = _offset_from_centre(yaw, rng.uniform(-2.0, 2.0))
    main = CrossedStreet("main", build_line(place, yaw, -2.0 * extent, 2.0 * extent, bends).until(extent), MAIN_STREET)
    at = 0.28 * radius
    cross = _cross_street("cross", main.line, at, 0.5 * math.pi + rng.uniform(-0.07, 0.07), CYCLE_STREET, extent)
    edge, edge_at = _edge_street(main.line, radius, OUTER_STREET, extent)
    streets, crossings = (
        [main, cross, edge],
        [
            build_crossing(
                "signals",
                (*_straight_arms(main, at, zebra=True), *_straight_arms(cross, 0.0, zebra=True)),
                "signal",
                7.0,
            ),
            build_crossing(
                "corner", (*_straight_arms(main, edge_at), *_straight_arms(edge, 0.0, minor=True)), "priority", 7.0
            ),
        ],
    )
    if radius >= 100.0:
        station = -0.47 * radius
        turn = -side * 0.5 * math.pi
        bend = Bend(0.5 * radius, 0.6 * radius, side * _bend_angle(0.6 * radius, 60.0, 0.3))
        lane = _branch_street("side", main.line, station, turn, SIDE_STREET, extent, (bend,))
        streets.append(lane)
        arms = (*_straight_arms(main, station), Arm(lane, 0.0, 1, minor=True, zebra=True))
        crossings.append(build_crossing("branch", arms, "priority", 5.5))
    ground = (
        _land_cover(Material.PAVING, Label.PAVEMENT, _YARD),
        _land_cover(Material.GRASS, Label.TERRAIN, GRASS),
        _land_cover(Material.GRAVEL, Label.TERRAIN, _DIRT),
        _land_cover(Material.GRASS, Label.TERRAIN, _MEADOW),
    )
    return Scheme(tuple(streets), tuple(crossings), 0.12, 0.010, 0.016, _paved_cover(), 5.0, (), ground)


def _campus_scheme(radius: float, yaw: float, rng: np.random.Generator) -> Scheme:
    extent = radius + BEYOND_M
    side = float(rng.choice((-1.0, 1.0)))
    first, second = 0.66 * radius, 0.46 * radius
    bends = (
        Bend(-0.30 * radius, first, side * _bend_angle(first, 45.0, rng.uniform(0.30, 0.40))),
        Bend(0.64 * radius, second, -side * _bend_angle(second, 45.0, rng.uniform(0.35, 0.50))),
    )
    main = CrossedStreet(
        "main",
        build_line(_offset_from_centre(yaw, 0.0), yaw, -2.0 * extent, 2.0 * extent, bends).until(extent),
        CAMPUS_STREET,
    )
    at = 0.28 * radius
    cross = _cross_street("cross", main.line, at, 0.5 * math.pi + rng.uniform(-0.1, 0.1), CAMPUS_STREET, extent)
    edge, edge_at = _edge_street(main.line, radius, OUTER_STREET, extent)
    crossings = (
        build_crossing(
            "middle",
            (*_straight_arms(main, at, zebra=True), *_straight_arms(cross, 0.0, minor=True, zebra=True)),
            "priority",
        ),
        build_crossing("corner", (*_straight_arms(main, edge_at), *_straight_arms(edge, 0.0, minor=True)), "priority"),
    )
    centre, reach = main.line.at(0.08 * radius, -side * (CAMPUS_STREET.half_m + 0.125 * radius)), 0.13 * radius
    plaza = shapely.Point(*centre).buffer(reach, quad_segs=6)
    covers = (Cover(plaza, Material.PAVING, Label.PAVEMENT, (0.36, 0.33, 0.29)),)
    parcels = (
        _land_cover(Material.GRASS, Label.TERRAIN, GRASS),
        _land_cover(Material.GRASS, Label.TERRAIN, _MEADOW),
        _land_cover(Material.GRASS, Label.TERRAIN, GRASS),
    )
    return Scheme(
        (main, cross, edge), crossings, 0.10, 0.012, 0.020, _paved_cover((0.33, 0.31, 0.28)), 0.0, covers, parcels
    )


def _rural_scheme(radius: float, yaw: float, rng: np.random.Generator) -> Scheme:
    extent = radius + BEYOND_M
    side = float(rng.choice((-1.0, 1.0)))
    bends = tuple(
        Bend(place * radius, length * radius, side * turn * _bend_angle(length * radius, 55.0, most))
        for place, length, turn, most in (
            (-0.62, 0.42, 1.0, 0.45),
            (-0.18, 0.46, -1.0, 0.70),
            (0.28, 0.44, 1.0, 0.65),
            (0.74, 0.40, -1.0, 0.50),
        )
    )
    main = CrossedStreet(
        "main",
        build_line(_offset_from_centre(yaw, 0.0), yaw, -2.0 * extent, 2.0 * extent, bends).until(extent),
        COUNTRY_ROAD,
    )
    track_at, lane_at = -0.16 * radius, 0.50 * radius
    bend = Bend(0.45 * radius, 0.5 * radius, side * _bend_angle(0.5 * radius, 40.0, 0.5))
    track = _branch_street("track", main.line, track_at, -side * 0.5 * math.pi, FARM_TRACK, extent, (bend,))
    lane = _branch_street("lane", main.line, lane_at, side * (0.5 * math.pi + 0.12), COUNTRY_ROAD, extent)
    edge, edge_at = _edge_street(main.line, radius, COUNTRY_ROAD, extent)
    crossings = (
        build_crossing("gate", (*_straight_arms(main, track_at), Arm(track, 0.0, 1, minor=True)), "priority", 5.0),
        build_crossing("fork", (*_straight_arms(main, lane_at), Arm(lane, 0.0, 1, minor=True)), "priority", 9.0),
        build_crossing(
            "corner", (*_straight_arms(main, edge_at), *_straight_arms(edge, 0.0, minor=True)), "priority", 9.0
        ),
    )
    shoulder = _land_cover(Material.GRAVEL, Label.TERRAIN, (0.22, 0.20, 0.16))
    parcels = tuple(
        _land_cover(material, Label.TERRAIN, colour)
        for material, colour in (
            (Material.GRASS, _MEADOW),
            (Material.GRASS, _CROP),
            (Material.GRAVEL, _SOIL),
            (Material.GRASS, _STUBBLE),
            (Material.GRASS, GRASS),
        )
    )
    return Scheme((main, lane, edge, track), crossings, 0.0, 0.018, 0.035, shoulder, 0.0, (), parcels)


def _highway_scheme(radius: float, yaw: float, rng: np.random.Generator) -> Scheme:
    extent = radius + BEYOND_M
    length = 1.6 * radius
    # The motorway curves to the left, away from its slip roads.
    bends = (Bend(0.1 * radius, length, _bend_angle(length, 350.0, rng.uniform(0.15, 0.35))),)
    main = CrossedStreet(
        "main",
        build_line(_offset_from_centre(yaw, -9.0), yaw, -2.0 * extent, 2.0 * extent, bends).until(extent),
        MOTORWAY,
    )
    verge = _land_cover(Material.GRASS, Label.TERRAIN, GRASS)
    parcels = (
        _land_cover(Material.GRASS, Label.TERRAIN, GRASS),
        _land_cover(Material.GRASS, Label.TERRAIN, _MEADOW),
        _land_cover(Material.GRASS, Label.TERRAIN, _STUBBLE),
        _land_cover(Material.GRASS, Label.TERRAIN, _CROP),
    )
    streets, crossings = _slip_roads(main, radius, extent)
    return Scheme((main, *streets), crossings, 0.0, 0.006, 0.014, verge, 0.0, (), parcels, -0.08 * radius)


def _slip_roads(
    main: CrossedStreet, radius: float, extent: float
) -> tuple[tuple[CrossedStreet, ...], tuple[Crossing, ...]]:
    """The entry and the exit after it, on the right of the carriageway along the line."""
    lane = next(track.offset_m for track in MOTORWAY.tracks if track.name == "drive1+")
    join, leave = -0.32 * radius, 0.10 * radius
    out = build_line(
        main.line.at(leave, lane), float(main.line.heading(leave)), 0.0, 2.0 * extent, (Bend(70.0, 110.0, -_SLIP_RAD),)
    )
    back = build_line(
        main.line.at(join, lane), float(main.line.heading(join)), -2.0 * extent, 0.0, (Bend(-70.0, 110.0, -_SLIP_RAD),)
    )
    exits, entries = (
        CrossedStreet("exit", _clip_line(out, extent), SLIP_ROAD),
        CrossedStreet("entry", _clip_line(back, extent), SLIP_ROAD),
    )
    return (exits, entries), (
        build_crossing("leave", (*_straight_arms(main, leave), Arm(exits, 0.0, 1)), "joint"),
        build_crossing("join", (*_straight_arms(main, join), Arm(entries, 0.0, -1)), "joint"),
    )


def _clip_line(line: Line, extent: float) -> Line:
    is_inside = arrays.hypot(*line.points.T) <= extent
    indices = np.flatnonzero(is_inside)
    part = slice(int(indices[0]), int(indices[-1]) + 1)
    stations = line.stations[part]
    return Line(float(stations[0]), float(stations[-1]), stations, line.points[part], line.headings[part])


def _offset_from_centre(yaw: float, left_m: float) -> Float64:
    return left_m * np.array([-scalars.sin(yaw), scalars.cos(yaw)])


SCHEMES: Final[dict[str, Callable[[float, float, np.random.Generator], Scheme]]] = {
    "urban": _urban_scheme,
    "campus": _campus_scheme,
    "rural": _rural_scheme,
    "highway": _highway_scheme,
}
