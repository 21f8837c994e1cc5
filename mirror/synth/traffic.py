"""The other road users of a drive: who is there differs from traversal to traversal."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from mirror.synth.driving import Drive, Following
from mirror.synth.road_users import Body, Motion, RoadUser, Straight, bus, car, cyclist, pedestrian, truck, van
from mirror.synth.world import HALF_ROAD_M, LANE_CENTRE_M, World


def traffic(world: World, drive: Drive, route: str, rng: np.random.Generator) -> tuple[RoadUser, ...]:
    """All that moves during a drive.

    Args:
        world: the scene.
        drive: of the recording vehicle, that none of them hits.
        route: its name.
        rng: of numbers, kinds and places.
    """
    found = [*_in_its_lane(drive, route, rng), *_oncoming(world, route, rng), *_at_the_crossing(world, rng)]
    found += [*_on_foot(world, rng), *_cycling(world, route, rng)]
    counts: dict[str, int] = {}
    users = []
    for body, motion in found:
        counts[body.category] = counts.get(body.category, 0) + 1
        users.append(RoadUser(f"{body.category}-{counts[body.category]:03d}", body, motion))
    return tuple(users)


def _vehicle(rng: np.random.Generator) -> Body:
    kind = rng.random()
    if kind < 0.70:
        return car(rng)
    if kind < 0.82:
        return van(rng)
    return truck(rng) if kind < 0.92 else bus(rng)


def _in_its_lane(drive: Drive, route: str, rng: np.random.Generator) -> Iterator[tuple[Body, Motion]]:
    if route in ("along", "back"):
        yield _vehicle(rng), Following(drive, rng.uniform(24.0, 34.0))
        yield car(rng), Following(drive, -rng.uniform(15.0, 22.0))


def _oncoming(world: World, route: str, rng: np.random.Generator) -> Iterator[tuple[Body, Motion]]:
    """A stream of one speed, so that nobody catches up with anybody."""
    if route not in ("along", "back", "turn"):
        return
    reach = world.roi.radius_m + 30.0
    speed = rng.uniform(8.0, 12.0)
    sign = -1.0 if route == "back" else 1.0
    at = rng.uniform(0.0, 20.0)
    while at < 2.0 * reach - 20.0:
        start = world.placement(sign * reach, sign * LANE_CENTRE_M, math.pi if sign > 0 else 0.0, speed)
        yield _vehicle(rng), Straight(start, 2.0 * reach, at)
        at += rng.uniform(22.0, 70.0)


def _at_the_crossing(world: World, rng: np.random.Generator) -> Iterator[tuple[Body, Motion]]:
    """Vehicles that wait at the cross street's stop lines."""
    for side in (1.0, -1.0):
        behind = HALF_ROAD_M + 5.4
        for _ in range(int(rng.integers(1, 4))):
            body = _vehicle(rng)
            length = body.size_m[0]
            at = side * (behind + 0.5 * length)
            yield body, Straight(world.placement(world.cross_m - side * LANE_CENTRE_M, at, -side * math.pi / 2))
            behind += length + rng.uniform(1.2, 2.5)


def _on_foot(world: World, rng: np.random.Generator) -> Iterator[tuple[Body, Motion]]:
    reach = world.roi.radius_m + 20.0
    for _ in range(round(0.11 * reach)):
        side, onward = rng.choice([1.0, -1.0], 2)
        start = world.placement(
            -onward * reach, side * (HALF_ROAD_M + rng.uniform(1.1, 2.0)), 0.0 if onward > 0 else math.pi,
            rng.uniform(1.0, 1.6),
        )  # fmt: skip
        yield pedestrian(rng), Straight(start, 2.0 * reach, rng.uniform(0.0, 2.0 * reach))


def _cycling(world: World, route: str, rng: np.random.Generator) -> Iterator[tuple[Body, Motion]]:
    if route == "corner":
        return
    reach = world.roi.radius_m + 20.0
    for side in (1.0, -1.0):
        speed = rng.uniform(3.5, 5.5)
        for at in rng.uniform(0.0, 2.0 * reach, 2):
            start = world.placement(side * reach, side * 3.35, math.pi if side > 0 else 0.0, speed)
            yield cyclist(rng), Straight(start, 2.0 * reach, float(at))
