"""Triangulates the ground: carriageways, kerbs, pavements and land, without gaps between them.

All outlines and cross-lines are merged into one planar arrangement on a grid of 1 mm, and its cells are triangulated.
So neighbouring triangles share their corners exactly. The centroid of a triangle decides its material. Every corner
has two heights: that of the carriageway and that of the kerb's top. Upright kerb faces close the step wherever a
carriageway meets another surface.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from mirror.arrays import AnyArray, Bool, Float64, Int64
from mirror.portable import arrays, scalars
from mirror.synth.model import Label, Material, Model, merge_models, polygons
from mirror.synth.roads.crossing import CrossedStreet, Crossing
from mirror.synth.roads.relief import Relief
from mirror.synth.roads.section import Section

_GRID_M: Final = 1e-3
_KERB_TOP_M: Final = 0.16
_CELL_M: Final = 24.0
_GROWTH: Final = 1.45
_PARCEL_CELLS: Final = (2, 3)
_KERB_GREY: Final = (0.34, 0.335, 0.32)


@dataclass(frozen=True)
class Cover:
    """A surface that covers a part of the land.

    Attributes:
        outline: the covered area; empty for a cover that parcels of land are assigned to.
        material: material of the surface.
        label: semantic label of the surface.
        colour: reflectance (r, g, b) of the surface.
    """

    outline: shapely.Geometry
    material: Material
    label: Label
    colour: tuple[float, float, float]


@dataclass(frozen=True)
class Stretch:
    """A part of a street, from one station to another, and the index of its marking layout."""

    street: int
    low_m: float
    high_m: float
    layout: int


@dataclass(frozen=True)
class Outlines:
    """Outlines of the carriageways alone, with their kerbs, and with the pavements beside them."""

    carriageway: shapely.Geometry
    kerbs: shapely.Geometry
    roads: shapely.Geometry


@dataclass(frozen=True)
class Ground:
    """The triangulated ground of a synthetic scene.

    Attributes:
        model: all faces of the ground.
        triangles: (T, 3, 3) corners of all triangles except the kerbs' upright faces, metres, counter-clockwise from
            above.
        outlines: outlines of the roads.
    """

    model: Model
    triangles: Float64
    outlines: Outlines


def merge_outlines(
    streets: Sequence[CrossedStreet], stations: Sequence[Float64], crossings: Sequence[Crossing], kerbs: bool
) -> Outlines:
    """Merge the outlines of all roads, with rounded corners at the crossings.

    Args:
        streets: all streets.
        stations: for each street, the stations at which its pieces end.
        crossings: all crossings.
        kerbs: whether the roads have kerbs.
    """
    outlines = []
    for beside in ("none", "kerb", "pavement"):
        parts: list[shapely.Geometry] = []
        for street, at in zip(streets, stations):
            section = street.section
            wider = {"none": 0.0, "kerb": _KERB_TOP_M if kerbs else 0.0, "pavement": section.pavement_m}[beside]
            outer = section.half_m + wider
            bands = [(-outer, outer)]
            if section.median_m and beside == "none":
                bands = [(-outer, -section.median_m), (section.median_m, outer)]
            parts += [_street_band(street, at, low, high, kerbs) for low, high in bands]
        for crossing in crossings:
            for corner in crossing.corners:
                narrow = min(crossing.arms[arm].street.section.pavement_m for arm in (corner.first, corner.second))
                wider = {
                    "none": 0.0,
                    "kerb": _KERB_TOP_M if kerbs else 0.0,
                    "pavement": min(narrow, corner.radius_m - 0.8),
                }[beside]
                parts.append(shapely.Polygon(crossing.patch(corner, wider)))
        outlines.append(shapely.union_all(parts, grid_size=_GRID_M))
    return Outlines(*outlines)


def _boundary_offsets(section: Section, kerbs: bool) -> Float64:
    """Offsets (N,) of the boundaries within a cross-section, from right to left."""
    kerb = section.half_m + (_KERB_TOP_M if kerbs else 0.0)
    half = np.array([section.median_m, section.half_m, kerb, section.half_m + section.pavement_m])
    return np.unique(np.concatenate([-half, [0.0], half]))


def _street_band(
    street: CrossedStreet, stations: Float64, low_m: float, high_m: float, kerbs: bool
) -> shapely.Geometry:
    """A band along a street; its two ends have a vertex at every boundary of the cross-section."""
    steps = _boundary_offsets(street.section, kerbs)
    across = steps[(steps > low_m) & (steps < high_m)]
    first, last = stations[0], stations[-1]
    return shapely.Polygon(
        np.vstack(
            [
                street.line.at(stations, low_m),
                street.line.at(last, across),
                street.line.at(stations[::-1], high_m),
                street.line.at(first, across[::-1]),
            ]
        )
    )


def build_ground(
    streets: Sequence[CrossedStreet],
    stations: Sequence[Float64],
    roads: Outlines,
    relief: Relief,
    stretches: Sequence[Stretch],
    covers: Sequence[Cover],
    parcels: Sequence[Cover],
    yaw_rad: float,
    extent_m: tuple[float, float],
    seed: int,
) -> Ground:
    """Triangulate the ground.

    Args:
        streets: all streets; where two overlap, the earlier one determines the surface.
        stations: for each street, the stations at which its pieces end.
        roads: outlines of the roads.
        relief: heights of carriageways and land.
        stretches: marking layouts along the streets.
        covers: covers of outlined parts of the land; where two overlap, the earlier one applies.
        parcels: covers of the remaining land, assigned to parcels of its grid.
        yaw_rad: direction of the land's grid, counter-clockwise from east.
        extent_m: half the width of the finely divided land, and half the width of all land.
        seed: seed of the parcels' covers and tones.
    """
    lines = [roads.carriageway.boundary, roads.kerbs.boundary, roads.roads.boundary]
    lines += [cover.outline.boundary for cover in covers]
    lines += _cross_lines(streets, stations, relief)
    grid = shapely.multilinestrings(shapely.linestrings(_grid_lines(yaw_rad, *extent_m)))
    lines.append(shapely.difference(grid, roads.roads, grid_size=_GRID_M))
    plane, number = _triangulate(lines)
    places = [street.line.locate(plane) for street in streets]
    low, high = relief.heights_m(plane, places)
    owner, along = _assign_streets(streets, places, number)
    middle = plane[number].mean(axis=1)
    driven = _contains(roads.carriageway, middle)
    height = np.where(driven[:, None], low[number], high[number])
    triangles = np.concatenate([plane[number], height[:, :, None]], axis=2)
    parts = [
        *_carriageway_models(triangles[driven], along[driven], owner[driven], streets, stretches),
        _kerb_faces(number, driven, plane, low, high),
    ]
    free = ~driven
    kerb_top = free & _contains(roads.kerbs, middle)
    if relief.kerb_m > 0.0:
        parts.append(polygons(triangles[kerb_top], _KERB_GREY, Material.KERB, Label.PAVEMENT, texture=along[kerb_top]))
        free &= ~kerb_top
    for cover in covers:
        here = free & _contains(cover.outline, middle)
        free &= ~here
        texture = along[here] if cover.label == Label.PAVEMENT else _land_texture(triangles[here], yaw_rad)
        parts.append(_cover_model(cover, triangles[here], texture, 1.0, seed))
    texture = _land_texture(triangles[free], yaw_rad)
    dealt, shade = _assign_parcels(texture.mean(axis=1), len(parcels), seed)
    for which, cover in enumerate(parcels):
        mine = dealt == which
        parts.append(_cover_model(cover, triangles[free][mine], texture[mine], shade[mine, None], seed + which))
    return Ground(merge_models(parts), triangles, roads)


def _triangulate(lines: Sequence[shapely.Geometry]) -> tuple[Float64, Int64]:
    """Corners (P, 2) and counter-clockwise triangles (T, 3) of the arrangement of the lines."""
    mesh = shapely.unary_union(np.array(lines), grid_size=_GRID_M)
    cells = shapely.get_parts(shapely.polygonize([mesh]))
    pieces = shapely.get_parts(shapely.constrained_delaunay_triangles(cells))
    corners = shapely.get_coordinates(pieces).reshape(-1, 4, 2)[:, :3]
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    clockwise = edge[:, 0] * other[:, 1] < edge[:, 1] * other[:, 0]
    corners[clockwise] = corners[clockwise][:, ::-1]
    points, number = np.unique(np.round(corners.reshape(-1, 2) / _GRID_M).astype(np.int64), axis=0, return_inverse=True)
    return points * _GRID_M, number.reshape(-1, 3)


def _contains(region: shapely.Geometry, points: Float64) -> Bool:
    shapely.prepare(region)
    return np.asarray(shapely.contains_xy(region, points[:, 0], points[:, 1]))


def _cross_lines(
    streets: Sequence[CrossedStreet], stations: Sequence[Float64], relief: Relief
) -> list[shapely.Geometry]:
    """Lines across the streets where pieces end, and along the crowns; none in crossings or on earlier streets."""
    lines_by_street: list[shapely.Geometry] = []
    covered: shapely.Geometry = shapely.Polygon()
    for number, (street, at) in enumerate(zip(streets, stations)):
        section, level = street.section, relief.level_at[number]
        inside = np.any((at[:, None] > level[:, 0] + 1e-6) & (at[:, None] < level[:, 1] - 1e-6), axis=1)
        ends = (at == at[0]) | (at == at[-1])
        steps = _boundary_offsets(section, relief.kerb_m > 0.0)
        lines = [shapely.LineString(street.line.at(station, steps)) for station in at[~(inside | ends)]]
        between = 0.5 * (at[1:] + at[:-1])
        crowned = ~((between[:, None] > level[:, 0]) & (between[:, None] < level[:, 1])).any(axis=1)
        crown = street.line.at(at, 0.0)
        lines += [shapely.LineString(crown[i : i + 2]) for i in np.flatnonzero(crowned)]
        lines_by_street.append(shapely.difference(shapely.MultiLineString(lines), covered, grid_size=_GRID_M))
        covered = shapely.union(
            covered, _street_band(street, at, steps[0], steps[-1], relief.kerb_m > 0.0), grid_size=_GRID_M
        )
    return lines_by_street


def _grid_lines(yaw_rad: float, fine_m: float, extent_m: float) -> AnyArray:
    """Lines (N, 2, 2) of the land's grid, rotated by the yaw; its cells grow outside ``fine_m``."""
    steps = [0.0]
    step = _CELL_M
    while steps[-1] < extent_m:
        step = step * _GROWTH if steps[-1] > fine_m else step
        steps.append(steps[-1] + step)
    at = np.array([-x for x in steps[:0:-1]] + steps)
    first, last = np.full_like(at, at[0]), np.full_like(at, at[-1])
    lines = np.concatenate(
        [np.stack([np.c_[at, first], np.c_[at, last]], axis=1), np.stack([np.c_[first, at], np.c_[last, at]], axis=1)]
    )
    cos, sin = scalars.cos(yaw_rad), scalars.sin(yaw_rad)
    return arrays.matmul(lines, np.array([[cos, sin], [-sin, cos]]))


def _assign_streets(
    streets: Sequence[CrossedStreet], places: Sequence[tuple[Float64, Float64]], number: Int64
) -> tuple[Int64, Float64]:
    """Assign each triangle to a street, and compute its corners' stations and offsets there.

    A triangle belongs to the first street that contains its centroid, else to the nearest street.

    Args:
        streets: all streets.
        places: for each street, stations and offsets of all corners.
        number: (T, 3) corner indices of the triangles.

    Returns:
        (T,) street indices; (T, 3, 2) stations and offsets, metres.
    """
    table = np.stack([np.stack(place, axis=1) for place in places])
    beyond = np.empty((len(streets), len(number)))
    for which, street in enumerate(streets):
        station, offset = table[which][number].mean(axis=1).T
        ends = np.maximum(street.line.first_m - station, station - street.line.last_m)
        beyond[which] = np.maximum(np.maximum(np.abs(offset) - street.section.half_m, ends), 0.0)
    owner = np.argmin(beyond, axis=0)
    return owner, table[owner[:, None], number]


def _carriageway_models(
    triangles: Float64, texture: Float64, owner: Int64, streets: Sequence[CrossedStreet], stretches: Sequence[Stretch]
) -> Iterator[Model]:
    station = texture[:, :, 0].mean(axis=1)
    layout = np.zeros(len(triangles), np.int64)
    for stretch in stretches:
        on = (owner == stretch.street) & (station > stretch.low_m) & (station < stretch.high_m)
        layout[on] = stretch.layout
    for which, street in enumerate(streets):
        mine, section = owner == which, street.section
        label = Label.ROAD if section.material == Material.ASPHALT else Label.TERRAIN
        yield polygons(
            triangles[mine], section.colour, section.material, label,
            texture=texture[mine], layouts=layout[mine], seeds=which,
        )  # fmt: skip


def _kerb_faces(number: Int64, driven: Bool, plane: Float64, low: Float64, high: Float64) -> Model:
    """Upright faces (towards the carriageway) along edges between a carriageway and a surface that is higher."""
    edges = np.concatenate([number[:, [0, 1]], number[:, [1, 2]], number[:, [2, 0]]])
    below = np.tile(driven, 3)
    key = edges.min(axis=1) * len(plane) + edges.max(axis=1)
    order = np.argsort(key, kind="stable")
    twin = key[order][1:] == key[order][:-1]
    first, second = order[:-1][twin], order[1:][twin]
    differ = below[first] != below[second]
    inner = np.where(below[first], first, second)[differ]
    start, end = edges[inner, 0], edges[inner, 1]
    step = (high[start] > low[start] + 1e-6) & (high[end] > low[end] + 1e-6)
    start, end = start[step], end[step]
    if not len(start):
        return Model.empty()
    corners = np.stack(
        [
            np.c_[plane[end], low[end]],
            np.c_[plane[start], low[start]],
            np.c_[plane[start], high[start]],
            np.c_[plane[end], high[end]],
        ],
        axis=1,
    )
    return polygons(corners, _KERB_GREY, Material.KERB, Label.PAVEMENT)


def _land_texture(triangles: Float64, yaw_rad: float) -> Float64:
    """Texture coordinates (T, 3, 2) along the axes of the land's grid, metres."""
    cos, sin = scalars.cos(yaw_rad), scalars.sin(yaw_rad)
    return arrays.matmul(triangles[:, :, :2], np.array([[cos, -sin], [sin, cos]]))


def _cover_model(cover: Cover, triangles: Float64, texture: Float64, shade: Float64 | float, seed: int) -> Model:
    if not len(triangles):
        return Model.empty()
    colours = np.asarray(cover.colour) * shade
    return polygons(triangles, colours, cover.material, cover.label, texture=texture, seeds=seed % 1000)


def _assign_parcels(middle: Float64, count: int, seed: int) -> tuple[Int64, Float64]:
    """For each centroid, the cover index (T,) of its parcel and a tone (T,) from 0.85 to 1.15."""
    row, column = (np.floor(middle / (_CELL_M * np.array(_PARCEL_CELLS))).astype(np.int64)).T
    mixed = (row * 73856093) ^ (column * 19349663) ^ (seed * 83492791)
    mixed = (mixed ^ (mixed >> 13)) * 1274126177 & 0x7FFFFFFF
    return (mixed >> 8) % count, 0.85 + 0.30 * ((mixed >> 16) % 1009) / 1009.0
