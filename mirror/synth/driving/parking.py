"""Parked cars: some are the same in every traversal, others change between traversals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.portable import arrays
from mirror.synth.driving.bodies import POPULATION, get_body
from mirror.synth.driving.site import TrafficSite
from mirror.synth.road_users.body import Body
from mirror.synth.seeds import random_stream
from mirror.traffic.following.participants import Kind
from mirror.traffic.lanes.network import Lane
from mirror.traffic.lanes.paths import select_lanes
from mirror.traffic.placement.motion import Placement, StaticMotion

_PITCH_M: Final = 6.2
_STAYS: Final = 0.42
_CHANGES: Final = 0.40
_OCCUPIED_SHARE: Final = 0.6
_LONGEST_M: Final = 5.5


@dataclass(frozen=True, eq=False)
class ParkedCar:
    """A parked car.

    Attributes:
        body: body of the car.
        motion: its constant placement.
        leaves: lane, length along the lane and number of the car if it may drive off; None otherwise.
    """

    body: Body
    motion: StaticMotion
    leaves: tuple[Lane, float, int] | None


def place_parked_cars(site: TrafficSite, seed: int, rng: np.random.Generator) -> Iterator[ParkedCar]:
    """Place the parked cars of a traversal.

    Args:
        site: the scene.
        seed: seed of the scene: the cars that are always there.
        rng: random numbers of the traversal: the other cars.
    """
    always = random_stream("parked cars", seed, 23)
    lanes = select_lanes(site.network, "park")
    for name in sorted(lanes):
        lane = lanes[name]
        for place in np.arange(0.5 * _PITCH_M, lane.length_m - 0.5 * _PITCH_M + 1e-6, _PITCH_M):
            stays, changes = _choose_car(always)
            offset, aside, skew, number, kind = _build_car(always)
            if not stays:
                occupancy, aside, skew, number, kind = _build_car(rng)
                if not changes or occupancy > _OCCUPIED_SHARE:
                    continue
            at = place + offset * 0.5
            body = get_body(kind, number)
            if body.size_m[0] > _LONGEST_M:
                continue
            leaves = None if stays or kind != "car" else (lane, at, number)
            yield ParkedCar(body, StaticMotion(_place_car(site, lane, at, aside, skew, body)), leaves)


def _choose_car(rng: np.random.Generator) -> tuple[bool, bool]:
    share = rng.random()
    return share < _STAYS, share < _STAYS + _CHANGES


def _build_car(rng: np.random.Generator) -> tuple[float, float, float, int, Kind]:
    kind: Kind = "car" if rng.random() < 0.9 else "van"
    return (
        float(rng.random()), float(rng.uniform(-0.08, 0.08)), float(rng.normal(0.0, 0.012)),
        int(rng.integers(POPULATION[kind])), kind,
    )  # fmt: skip


def _place_car(site: TrafficSite, lane: Lane, at: float, aside: float, skew: float, body: Body) -> Placement:
    half = 0.3 * body.size_m[0]
    along = np.array([at - half, at, at + half])
    x, y = (np.interp(along, lane.along_m, lane.line[:, axis]) for axis in (0, 1))
    yaw = float(arrays.arctan2(y[2] - y[0], x[2] - x[0])) + skew
    left = np.array([-arrays.sin(yaw), arrays.cos(yaw)])
    track = 0.4 * body.size_m[1]
    wheels_x = np.array([x[0], x[2], x[1] + track * left[0], x[1] - track * left[0]]) - aside * left[0]
    wheels_y = np.array([y[0], y[2], y[1] + track * left[1], y[1] - track * left[1]]) - aside * left[1]
    back, front, port, starboard = site.height_m(wheels_x, wheels_y)
    return Placement(
        float(x[1] - aside * left[0]), float(y[1] - aside * left[1]), float(0.5 * (back + front)), yaw,
        float(arrays.arctan2(front - back, 2.0 * half)), float(arrays.arctan2(port - starboard, 2.0 * track)),
    )  # fmt: skip
