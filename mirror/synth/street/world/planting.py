"""Plants trees at a plan's spots, and trees, bushes and hedges on its open land."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Final

import numpy as np
import shapely

from mirror.arrays import Float64
from mirror.portable import arrays, scalars
from mirror.synth.model import Material, Model
from mirror.synth.seeds import random_stream
from mirror.synth.street.plan import StreetPlan
from mirror.synth.street.plants import STREET_TREES, Kind, build_bush, build_hedge, build_tree

_FIELD_TREES: Final[tuple[Kind, ...]] = ("oak", "birch", "poplar", "spruce", "pine", "lime")
_GARDEN_TREES: Final[tuple[Kind, ...]] = ("oak", "plane", "birch", "cherry", "pine", "cypress")
_MODELS_PER_KIND: Final = 4
"""Number of models per kind of tree; each is planted at many places with random rotations."""
_OPEN_LAND_PLANTS: Final = {"urban": (30, 30), "campus": (90, 70), "rural": (110, 60), "highway": (90, 50)}
"""Numbers of trees and of bushes on open land."""
_CLEAR_M: Final = {"urban": 2.5, "campus": 4.0, "rural": 5.0, "highway": 12.0}
"""Smallest distance of these from roads and houses, metres."""
_DETAIL_RANGE_M: Final = 25.0
_ROAD_M: Final = {"urban": 0.9, "campus": 0.9, "rural": 3.0, "highway": 8.0}
"""Distance of the trees at spots from the carriageway, metres."""


def build_plants(plan: StreetPlan, seed: int) -> Iterator[Model]:
    """Yield trees, bushes and hedges in full leaf, in the world frame.

    Args:
        plan: plan of the scene.
        seed: seed of all random choices.
    """
    rng = random_stream("plants", seed, 24)
    streets = [str(kind) for kind in rng.choice(STREET_TREES, 2, replace=False)]
    kinds = (
        _FIELD_TREES if plan.kind in ("rural", "highway") else tuple(kind for kind in STREET_TREES if kind in streets)
    )
    row = [build_tree(rng, kind, road_m=_ROAD_M[plan.kind]) for kind in kinds for _ in range(_MODELS_PER_KIND)]
    thin_row = [_thin_leaves(model) for model in row]
    for number, spot in enumerate(plan.spots):
        if spot.kind == "tree" and plan.carriageways.distance(shapely.Point(spot.place[:2])) > 0.8 * _ROAD_M[plan.kind]:
            spot_rng = random_stream("trees", seed, 25, number)
            models = row if _is_near(plan, spot.place) else thin_row
            yield _place_tree(models[int(spot_rng.integers(len(models)))], spot.place, spot_rng)
    loose = _FIELD_TREES if plan.kind in ("rural", "highway") else _GARDEN_TREES
    grown = [build_tree(rng, kind) for kind in loose for _ in range(_MODELS_PER_KIND // 2)]
    bushes = [build_bush(rng, evergreen=bool(number % 2)) for number in range(6)]
    trees, shrubs = _OPEN_LAND_PLANTS[plan.kind]
    thin = [_thin_leaves(model) for model in grown]
    for place in _open_places(plan, trees, rng):
        yield _place_tree((grown if _is_near(plan, place) else thin)[int(rng.integers(len(grown)))], place, rng)
    for place in _open_places(plan, shrubs, rng):
        yield _place_tree(bushes[int(rng.integers(len(bushes)))], place, rng)
    for number, rail in enumerate(plan.rails):
        if rail.kind == "hedge":
            yield from _hedge_row(rail.line, random_stream("hedges", seed, 26, number))


def _is_near(plan: StreetPlan, place: Float64) -> bool:
    """Return whether a position is visible from nearby: within or just outside the ROI, and near the roads."""
    within = float(arrays.hypot(place[0], place[1])) < plan.roi.radius_m + _DETAIL_RANGE_M
    return within and plan.roads.distance(shapely.Point(place[:2])) < _DETAIL_RANGE_M


def _thin_leaves(model: Model) -> Model:
    """A cheaper tree for distant places: a third of its leaves around a larger inside."""
    leaves = np.flatnonzero(model.faces["material"] == Material.LEAVES)
    is_kept = np.ones(len(model.faces), np.bool_)
    is_kept[leaves] = np.arange(len(leaves)) % 3 == 0
    rounds = model.rounds.copy()
    rounds["half"] *= 1.12
    faces = model.faces[is_kept]
    begins = np.cumsum(faces["count"]) - faces["count"]
    corners = model.corners[np.repeat(faces["first"] - begins, faces["count"]) + np.arange(faces["count"].sum())]
    faces["first"] = begins
    return Model(faces, corners, rounds)


def _place_tree(model: Model, place: Float64, rng: np.random.Generator) -> Model:
    return model.place(float(place[0]), float(place[1]), float(place[2]), float(rng.uniform(0.0, 2.0 * math.pi)))


def _open_places(plan: StreetPlan, number: int, rng: np.random.Generator) -> Float64:
    """Positions (N, 3) on open land, in loose groups."""
    reach = plan.roi.radius_m + 60.0
    middles = rng.uniform(-reach, reach, (number, 2))
    near = middles[rng.integers(number, size=6 * number)] + rng.normal(0.0, 7.0, (6 * number, 2))
    near = near[arrays.hypot(near[:, 0], near[:, 1]) < reach]
    near = near[plan.is_free(near[:, 0], near[:, 1], _CLEAR_M[plan.kind])][:number]
    return np.c_[near, plan.height_m(near[:, 0], near[:, 1])]


def _hedge_row(line: Float64, rng: np.random.Generator) -> Iterator[Model]:
    """Yield hedges along the segments of a line."""
    for start, end in pairwise(line):
        step = end - start
        length = float(arrays.hypot(step[0], step[1]))
        if length > 0.5:
            x, y, z = (0.5 * (start + end)).tolist()
            yield build_hedge(rng, length).place(x, y, z, scalars.atan2(step[1], step[0]))
