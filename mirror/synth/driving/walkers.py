"""Who is on foot: walking along the pavements, crossing, standing together, waiting for a bus."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.synth.driving.bodies import POPULATION, body_of
from mirror.synth.driving.participants import Manner, Participant
from mirror.synth.driving.paths import Path, lanes_of, turn_rad
from mirror.synth.driving.site import Bustle, Site
from mirror.synth.driving.trace import Aside, Chassis
from mirror.synth.driving.vehicles import Ways
from mirror.synth.street.network import Lane
from mirror.synth.users.body import Body, Placement, Still

_EVERY_M: Final = 100.0
"""Pavement a person, on a busy day; a group counts as one."""
_FILES_M: Final = (0.35, 0.95)
"""People keep to the right of a pavement's middle, in files."""
_FILE_ALONE_M: Final = 0.62
_FAR_M: Final = 330.0
_CROSSES: Final = 0.35
_MARGIN_M: Final = 45.0
_GROUPS: Final = 6
_RING_M: Final = 0.62
_WALL_M: Final = 1.45
_LEAST_WIDTH_M: Final = 1.7


def walkers(site: Site, bustle: Bustle, ways: Ways, rng: np.random.Generator) -> Iterator[Participant]:
    """Everybody who walks; they are there from the beginning, all over the scene.

    Args:
        site: the scene.
        bustle: how much is going on.
        ways: where theirs are kept.
        rng: decides.
    """
    lanes = lanes_of(site.network, "walk", "cross")
    starts = [lane for lane in _by_id(lanes) if lane.use == "walk" and lane.length_m > 20.0]
    if not starts:
        return
    lengths = np.array([lane.length_m for lane in starts])
    files = (_FILE_ALONE_M,) if bustle.umbrellas else _FILES_M
    paces = {file: rng.uniform(0.92, 1.08) for file in files}
    for _ in range(round(bustle.people * lengths.sum() / _EVERY_M)):
        start = starts[int(rng.choice(len(starts), p=lengths / lengths.sum()))]
        way = ways.along(_stroll(lanes, start, rng))
        enter = rng.uniform(0.0, start.length_m)
        if math.hypot(*way.at(enter)) > site.radius_m + _MARGIN_M:
            continue
        # Two of a group go side by side, at one pace.
        group = files if rng.random() < 0.3 else (files[int(rng.integers(len(files)))],)
        pace = paces[group[0]] if len(group) == 1 else 1.0
        for file in group:
            number = int(rng.integers(POPULATION["pedestrian"]))
            length, width, _ = _somebody(number, bustle).size_m
            chassis = Chassis(float(length), float(width), 0.4, 0.5 * float(length) - 0.2, 0.2)
            manner = Manner(pace, 3.0, 0.9, 1.2, 0.4, 0.0)
            yield Participant("pedestrian", number, way, chassis, manner, Aside(file), 0.0, enter)


def standing(site: Site, bustle: Bustle, rng: np.random.Generator) -> Iterator[tuple[Body, Still]]:
    """People who stand together by the walls, and those who wait for buses.

    Args:
        site: the scene.
        bustle: how much is going on.
        rng: decides.
    """
    lanes = [
        lane
        for lane in _by_id(lanes_of(site.network, "walk"))
        if lane.length_m > 30.0 and lane.width_m > _LEAST_WIDTH_M
    ]
    roads = lanes_of(site.network, "drive", "park", "cycle")
    if not lanes or not roads:
        return
    road = np.vstack([lane.line[:, :2] for lane in roads.values()])
    wanted = [(lanes[int(rng.integers(len(lanes)))], None) for _ in range(round(bustle.people * _GROUPS))]
    wanted += [(_nearest(lanes, stop), stop) for stop in site.bus_stops]
    for lane, stop in wanted:
        at = rng.uniform(8.0, lane.length_m - 8.0)
        if stop is not None:
            at = float(lane.along_m[np.argmin(np.sum((lane.line[:, :2] - stop) ** 2, axis=1))])
        place = np.array([np.interp(at, lane.along_m, lane.line[:, axis]) for axis in (0, 1)])
        if np.hypot(*place) > site.radius_m + _MARGIN_M:
            continue
        kerb = road[np.argmin(np.sum((road - place) ** 2, axis=1))] - place
        away = -kerb / np.hypot(*kerb)
        middle = place + _WALL_M * away
        count = int(rng.integers(2, 5))
        turn = rng.uniform(0.0, 2.0 * math.pi)
        for member in range(count):
            angle = turn + 2.0 * math.pi * member / count
            ring = _RING_M * (1.6 if bustle.umbrellas else 1.0)
            spot = middle + ring * np.array([math.cos(angle), math.sin(angle)])
            yaw = angle + math.pi + rng.uniform(-0.3, 0.3)
            if stop is not None:
                along = np.array([-away[1], away[0]])
                spot = middle + (member - 0.5 * count) * 0.95 * along
                yaw = math.atan2(-away[1], -away[0]) + rng.uniform(-0.6, 0.6)
            height = float(site.height_m(spot[:1], spot[1:])[0])
            body = _somebody(int(rng.integers(POPULATION["pedestrian"])), bustle)
            yield body, Still(Placement(float(spot[0]), float(spot[1]), height, yaw))


def _somebody(number: int, bustle: Bustle) -> Body:
    return body_of("pedestrian", number, bustle.umbrellas, bustle.warm)


def _by_id(lanes: dict[str, Lane]) -> list[Lane]:
    return [lanes[name] for name in sorted(lanes)]


def _nearest(lanes: list[Lane], place: Float64) -> Lane:
    return min(lanes, key=lambda lane: float(np.min(np.sum((lane.line[:, :2] - place) ** 2, axis=1))))


def _stroll(lanes: dict[str, Lane], start: Lane, rng: np.random.Generator) -> Path:
    """Onwards along pavements, now and then over a street."""
    path = [start]
    while sum(lane.length_m for lane in path) < _FAR_M:
        last = path[-1]
        following = [lanes[name] for name in last.successors if all(name != lane.lane_id for lane in path)]
        # Over a crossing's corner, not back to the side one has come from.
        following = [lane for lane in following if abs(turn_rad(lane)) < 2.5]
        if not following:
            break
        weights = np.array([_CROSSES if lane.use == "cross" else 1.0 for lane in following])
        path.append(following[int(rng.choice(len(following), p=weights / weights.sum()))])
    return Path(tuple(path))
