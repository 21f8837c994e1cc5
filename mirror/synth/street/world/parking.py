"""Places parked vehicles on parking lanes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from mirror.portable import scalars
from mirror.synth.model import Label, Material
from mirror.synth.road_users.body import Body, RoadUser
from mirror.synth.road_users.cars import build_car
from mirror.synth.road_users.vans import build_van
from mirror.synth.seeds import random_stream
from mirror.synth.street.plan import StreetPlan
from mirror.synth.textures.catalogue import PLATES
from mirror.traffic.lanes.network import Lane
from mirror.traffic.placement.motion import Placement, StaticMotion

_BAY_M: Final = 6.2
_OCCUPIED_SHARE: Final = 0.62
_VANS: Final = 0.12
_BODIES: Final = 16
"""Number of different bodies; each is parked at several places with different number plates."""


def place_parked_vehicles(plan: StreetPlan, seed: int) -> tuple[RoadUser, ...]:
    """Place vehicles on a plan's parking lanes, in driving direction.

    Args:
        plan: plan of the scene.
        seed: seed of all random choices.
    """
    lanes = [lane for lane in plan.network.lanes.values() if lane.use == "park"]
    if not lanes:
        return ()
    rng = random_stream("parked vehicles", seed, 27)
    bodies = [build_van(rng) if rng.random() < _VANS else build_car(rng) for _ in range(_BODIES)]
    placements = [place for lane in lanes for place in _bays(plan, lane, rng)]
    return tuple(
        RoadUser(f"parked-{number:03d}", _with_plate(bodies[int(rng.integers(_BODIES))], rng), StaticMotion(place))
        for number, place in enumerate(placements)
    )


def _bays(plan: StreetPlan, lane: Lane, rng: np.random.Generator) -> Iterator[Placement]:
    """Yield placements for the occupied bays of a lane."""
    for bay in range(int((lane.length_m - 1.0) / _BAY_M)):
        is_occupied, jitter = rng.random() < _OCCUPIED_SHARE, rng.uniform(-0.35, 0.35, 2)
        if not is_occupied:
            continue
        at = (bay + 0.5) * _BAY_M + jitter[0]
        ends = np.array([at - 1.3, at + 1.3])
        x, y = (np.interp(ends, lane.along_m, lane.line[:, axis]) for axis in (0, 1))
        yaw = scalars.atan2(y[1] - y[0], x[1] - x[0])
        aside = 0.25 * jitter[1] * np.array([-scalars.sin(yaw), scalars.cos(yaw)])
        middle = 0.5 * np.array([x.sum(), y.sum()]) + aside
        heights = plan.height_m(x + aside[0], y + aside[1])
        across = middle + 0.75 * np.array(
            [[-scalars.sin(yaw), scalars.cos(yaw)], [scalars.sin(yaw), -scalars.cos(yaw)]]
        )
        left, right = plan.height_m(across[:, 0], across[:, 1]).tolist()
        pitch = scalars.atan2(float(heights[1] - heights[0]), 2.6)
        roll = scalars.atan2(left - right, 1.5)
        yield Placement(float(middle[0]), float(middle[1]), float(heights.mean()), yaw, pitch, roll)


def _with_plate(body: Body, rng: np.random.Generator) -> Body:
    """The same body with another number plate."""
    faces = body.model.faces.copy()
    plates = (faces["material"] == Material.IMAGE) & np.isin(faces["image"], PLATES) & (faces["label"] >= Label.CAR)
    faces["image"][plates] = int(rng.choice(PLATES))
    return replace(body, model=replace(body.model, faces=faces))
