"""The pedestrians of a scene: walking along pavements, crossing, standing in groups, waiting for a bus."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays, scalars
from mirror.synth.driving.bodies import POPULATION, get_body
from mirror.synth.driving.site import TrafficDensity, TrafficSite
from mirror.synth.driving.vehicles import WayCache
from mirror.synth.road_users.body import Body
from mirror.traffic.following.participants import Manner, Participant
from mirror.traffic.lanes.network import Lane
from mirror.traffic.lanes.paths import Path, select_lanes, turn_rad
from mirror.traffic.placement.motion import Placement, StaticMotion
from mirror.traffic.placement.trace import Aside, Chassis

_EVERY_M: Final = 75.0
"""Length of pavement per person on a busy day; a group counts as one person."""
_FILES_M: Final = (0.32, 0.88)
"""Offsets of the files of pedestrians to the right of a pavement's middle."""
_FILE_ALONE_M: Final = 0.62
_FAR_M: Final = 330.0
_CROSSES: Final = 0.35
_MARGIN_M: Final = 45.0
_PAIRS: Final = 7
_TALK_M: Final = 1.3
_WALL_M: Final = 1.42
_SHELTER_M: Final = 2.8
_QUEUE_M: Final = 1.3
_LEAST_WIDTH_M: Final = 1.7


def make_walkers(
    site: TrafficSite, bustle: TrafficDensity, ways: WayCache, rng: np.random.Generator
) -> Iterator[Participant]:
    """Make the walking pedestrians, who are in the scene from the beginning.

    Args:
        site: the scene.
        bustle: density of the traffic.
        ways: cache of ways.
        rng: random numbers.
    """
    lanes = select_lanes(site.network, "walk", "cross")
    starts = [lane for lane in _lanes_by_id(lanes) if lane.use == "walk" and lane.length_m > 20.0]
    if not starts:
        return
    lengths = np.array([lane.length_m for lane in starts])
    files = (_FILE_ALONE_M,) if bustle.umbrellas else _FILES_M
    paces = {file: rng.uniform(0.92, 1.08) for file in files}
    for _ in range(round(bustle.people * lengths.sum() / _EVERY_M)):
        start = starts[int(rng.choice(len(starts), p=lengths / lengths.sum()))]
        way = ways.along(_draw_stroll(lanes, start, rng))
        enter = rng.uniform(0.0, start.length_m)
        if scalars.hypot(*way.at(enter)) > site.radius_m + _MARGIN_M:
            continue
        # Two pedestrians of a group walk side by side at the same speed.
        group = files if rng.random() < 0.3 else (files[int(rng.integers(len(files)))],)
        pace = paces[group[0]] if len(group) == 1 else 1.0
        for file in group:
            number = int(rng.integers(POPULATION["pedestrian"]))
            length, width, _ = _make_person(number, bustle).size_m
            chassis = Chassis(float(length), float(width), 0.4, 0.5 * float(length) - 0.2, 0.2)
            manner = Manner(pace, 3.0, 0.9, 1.2, 0.4, 0.0)
            yield Participant("pedestrian", number, way, chassis, manner, Aside(file), 0.0, enter)


def place_standing_people(
    site: TrafficSite, bustle: TrafficDensity, rng: np.random.Generator
) -> Iterator[tuple[Body, StaticMotion]]:
    """Place people who stand in groups near walls, and people who wait for buses.

    Args:
        site: the scene.
        bustle: density of the traffic.
        rng: random numbers.
    """
    lanes = [
        lane
        for lane in _lanes_by_id(select_lanes(site.network, "walk"))
        if lane.length_m > 30.0 and lane.width_m > _LEAST_WIDTH_M
    ]
    roads = select_lanes(site.network, "drive", "park", "cycle")
    if not lanes or not roads:
        return
    road = np.vstack([lane.line[:, :2] for lane in roads.values()])
    for _ in range(round(bustle.people * _PAIRS)):
        lane = lanes[int(rng.integers(len(lanes)))]
        at, turn, two = rng.uniform(8.0, lane.length_m - 8.0), rng.uniform(-0.2, 0.2), rng.random() < 0.8
        place, ahead = _place_at(lane, at)
        kerb = road[np.argmin(np.sum((road - place) ** 2, axis=1))] - place
        by_wall = place - _WALL_M * kerb / arrays.hypot(*kerb)
        yaw = scalars.atan2(ahead[1], ahead[0])
        for side in (-1.0, 1.0) if two else (1.0,):
            spot = by_wall + 0.5 * side * _TALK_M * ahead
            yield from _place_person(site, bustle, spot, yaw + turn + (math.pi if side > 0.0 else 0.0), rng)
    for stop in site.bus_stops:
        lane = _nearest_lane(lanes, stop)
        _, ahead = _place_at(lane, float(lane.along_m[np.argmin(np.sum((lane.line[:, :2] - stop) ** 2, axis=1))]))
        for member in range(int(rng.integers(1, 5))):
            spot = stop + (_SHELTER_M + _QUEUE_M * member) * ahead
            yield from _place_person(
                site, bustle, spot, scalars.atan2(-ahead[1], -ahead[0]) + rng.normal(0.0, 0.12), rng
            )


def _place_at(lane: Lane, at: float) -> tuple[Float64, Float64]:
    """The point (2,) at a length along a lane, and the direction (2,) there."""
    low, high = (
        np.array([np.interp(at + step, lane.along_m, lane.line[:, axis]) for axis in (0, 1)]) for step in (-0.5, 0.5)
    )
    return 0.5 * (low + high), (high - low) / arrays.hypot(*(high - low))


def _place_person(
    site: TrafficSite, bustle: TrafficDensity, spot: Float64, yaw: float, rng: np.random.Generator
) -> Iterator[tuple[Body, StaticMotion]]:
    body = _make_person(int(rng.integers(POPULATION["pedestrian"])), bustle)
    if arrays.hypot(*spot) < site.radius_m + _MARGIN_M:
        height = float(site.height_m(spot[:1], spot[1:])[0])
        yield body, StaticMotion(Placement(float(spot[0]), float(spot[1]), height, yaw))


def _make_person(number: int, bustle: TrafficDensity) -> Body:
    return get_body("pedestrian", number, bustle.umbrellas, bustle.warm)


def _lanes_by_id(lanes: dict[str, Lane]) -> list[Lane]:
    return [lanes[name] for name in sorted(lanes)]


def _nearest_lane(lanes: list[Lane], place: Float64) -> Lane:
    return min(lanes, key=lambda lane: float(np.min(np.sum((lane.line[:, :2] - place) ** 2, axis=1))))


def _draw_stroll(lanes: dict[str, Lane], start: Lane, rng: np.random.Generator) -> Path:
    """Draw a path along pavements, with occasional crossings."""
    path = [start]
    while sum(lane.length_m for lane in path) < _FAR_M:
        last = path[-1]
        following = [lanes[name] for name in last.successors if all(name != lane.lane_id for lane in path)]
        # A pedestrian does not cross back to the side it came from.
        following = [lane for lane in following if abs(turn_rad(lane)) < 2.5]
        if not following:
            break
        weights = np.array([_CROSSES if lane.use == "cross" else 1.0 for lane in following])
        path.append(following[int(rng.choice(len(following), p=weights / weights.sum()))])
    return Path(tuple(path))
