"""Builds a scene's static world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64, Int64, Records
from mirror.schema.documents import Roi
from mirror.synth.model import Model, merge_models
from mirror.synth.road_users.body import RoadUser
from mirror.synth.seeds import random_stream
from mirror.synth.street.houses import build_far_houses, build_far_woods
from mirror.synth.street.plan import StreetPlan, plan_scene
from mirror.synth.street.world.furnishing import Furniture, furnish
from mirror.synth.street.world.housing import build_houses
from mirror.synth.street.world.parking import place_parked_vehicles
from mirror.synth.street.world.planting import build_plants
from mirror.traffic.lanes.network import Network

AMBER_S: Final = 3.0
"""Duration of amber after a signal's green."""
READY_S: Final = 1.0
"""Duration of red and amber before a signal's green."""


@dataclass(frozen=True)
class Lights:
    """The lamps of one signal group, as faces of the world's model.

    Attributes:
        red: indices of the red lamps.
        amber: indices of the amber lamps.
        green: indices of the green lamps.
    """

    red: Int64
    amber: Int64
    green: Int64


@dataclass(frozen=True, eq=False)
class World:
    """All static objects of a scene, in its world frame: east, north, up, metres, the origin at the ROI's centre.

    Attributes:
        plan: plan of the scene.
        model: ground, houses, furniture, plants in full leaf, and skyline. Plants come last, so that removing leaves
            does not change the indices of the other faces.
        lamps: (M, 3) light sources of the street lamps, metres.
        lights: lamps of the traffic lights, by signal group.
        parked: parked vehicles; their bodies are not part of ``model``.
        seed: seed of all random choices.
    """

    plan: StreetPlan
    model: Model
    lamps: Float64
    lights: Mapping[int, Lights]
    parked: tuple[RoadUser, ...]
    seed: int = field(repr=False)

    @property
    def roi(self) -> Roi:
        """The region of interest."""
        return self.plan.roi

    @property
    def yaw_rad(self) -> float:
        """Direction of the main street at the ROI's centre, counter-clockwise from east."""
        return self.plan.yaw_rad

    @property
    def network(self) -> Network:
        """The lanes of the world's streets."""
        return self.plan.network

    @property
    def layouts(self) -> Records:
        """Marking layouts, indexed by the ``layout`` of the carriageways' faces."""
        return self.plan.layouts

    def height_m(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> Float64:
        """Return the heights (...,) of the ground at positions.

        Raises:
            UsageError: a position is outside the ground, or not finite.
        """
        return self.plan.height_m(x_m, y_m)

    def find_lit_lamps(self, time_s: float) -> Int64:
        """Return the faces of traffic lights that are lit at a time of the signals' cycle."""
        network, lamps_by_group = self.plan.network, [np.zeros(0, np.int64)]
        for group, lights in self.lights.items():
            start, end = network.green_s[group]
            since = (time_s - start) % network.cycle_s
            if since < end - start:
                lamps_by_group.append(lights.green)
            elif since < end - start + AMBER_S:
                lamps_by_group.append(lights.amber)
            else:
                lamps_by_group.append(lights.red)
                if since > network.cycle_s - READY_S:
                    lamps_by_group.append(lights.amber)
        return np.concatenate(lamps_by_group)


def build_world(roi: Roi, yaw_deg: float, seed: int) -> World:
    """Build a scene's world.

    Args:
        roi: the region of interest; its radius sets the extent, its ``scene_type`` the kind (default: urban).
        yaw_deg: direction of the main street at the centre, counter-clockwise from east.
        seed: seed of all random choices.

    Raises:
        UsageError: the ROI's radius is below 50 or above 400 m.
    """
    plan = plan_scene(roi, yaw_deg, seed)
    things = furnish(plan, seed)
    lights = _collect_lights(things)
    model = merge_models(
        [
            *(head.model for _, head in things.signals),
            plan.ground,
            *build_houses(plan, seed),
            *(lamp.model for lamp in things.lamps),
            *things.others,
            *_build_skyline(plan, seed),
            *build_plants(plan, seed),
        ]
    )
    lamps = np.concatenate([np.zeros((0, 3)), *(lamp.lights for lamp in things.lamps)])
    return World(plan, model, lamps, lights, place_parked_vehicles(plan, seed), seed)


def _collect_lights(things: Furniture) -> dict[int, Lights]:
    """Lamps of the traffic lights by signal group; their faces come first in the world's model."""
    lamps_by_group: dict[int, list[tuple[Int64, Int64, Int64]]] = {}
    first = 0
    for group, head in things.signals:
        lamps_by_group.setdefault(group, []).append((head.red + first, head.amber + first, head.green + first))
        first += len(head.model.faces)
    return {group: Lights(*(np.concatenate(part) for part in zip(*parts))) for group, parts in lamps_by_group.items()}


def _build_skyline(plan: StreetPlan, seed: int) -> list[Model]:
    """The skyline on all sides."""
    rng = random_stream("skyline", seed, 28)
    radius = plan.roi.radius_m
    if plan.kind == "urban":
        return [
            build_far_houses(rng, radius + 100.0, radius + 225.0, (9.0, 34.0), plan.height_m),
            build_far_woods(rng, radius + 232.0, radius + 256.0, (10.0, 16.0), plan.height_m),
        ]
    if plan.kind == "campus":
        return [
            build_far_houses(rng, radius + 140.0, radius + 230.0, (8.0, 22.0), plan.height_m),
            build_far_woods(rng, radius + 110.0, radius + 250.0, (10.0, 17.0), plan.height_m),
        ]
    return [build_far_woods(rng, radius + 120.0, radius + 256.0, (9.0, 17.0), plan.height_m)]
