"""The vehicles and cyclists of a scene, and the times of their entry."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from mirror.portable import arrays
from mirror.synth.driving.bodies import POPULATION, get_body
from mirror.synth.driving.site import TrafficDensity, TrafficSite
from mirror.traffic.following.participants import Kind, Manner, Participant
from mirror.traffic.lanes.network import Lane, Network
from mirror.traffic.lanes.paths import Path, beside_m, draw_path, iterate_paths, select_lanes, source_lanes
from mirror.traffic.lanes.ways import Piece, Way, build_way, change_lane_pieces, lane_piece
from mirror.traffic.placement.trace import Aside, Chassis

_MIX: Final[dict[Kind, float]] = {"car": 0.78, "van": 0.10, "truck": 0.05, "bus": 0.03, "motorcycle": 0.04}
_MOTORWAY_MIX: Final[dict[Kind, float]] = {"car": 0.62, "van": 0.11, "truck": 0.22, "bus": 0.03, "motorcycle": 0.02}
_MOTORWAY_MPS: Final = 25.0
# Farm tracks, on which two vehicles can hardly pass each other.
_TRACK_MPS: Final = 7.0
_PER_HOUR: Final = ((_TRACK_MPS, 10.0), (9.0, 110.0), (15.0, 330.0), (_MOTORWAY_MPS, 260.0), (math.inf, 800.0))
"""Vehicles per hour and lane, by the speed limit."""
_LEAST_HEADWAY_S: Final = 1.8
_FASTEST: Final[dict[Kind, float]] = {"car": 60.0, "van": 38.0, "truck": 23.5, "bus": 27.0, "motorcycle": 60.0}
_LIVELY: Final[dict[Kind, tuple[float, float]]] = {
    "car": (1.7, 1.3), "van": (1.4, 1.4), "truck": (0.9, 1.7), "bus": (1.0, 1.6), "motorcycle": (2.2, 1.3),
}  # fmt: skip
"""Acceleration, m/s2, and headway, s."""
_CYCLES_PER_HOUR: Final = 70.0
_CYCLING_MPS: Final = (4.2, 6.5)
_KERB_M: Final = 0.18
_BUS_STOP_M: Final = 9.0
_CHANGES: Final = 0.3
_CHANGE_M: Final = 80.0


def draw_manner(kind: Kind, rng: np.random.Generator) -> Manner:
    """Draw the driving style of a driver."""
    quick, headway = _LIVELY[kind]
    lively = rng.uniform(0.85, 1.15)
    return Manner(
        eager=rng.uniform(0.86, 1.06),
        fastest_mps=_FASTEST[kind] * rng.uniform(0.95, 1.02),
        pick_up_mps2=quick * lively,
        brake_mps2=2.0 * lively,
        headway_s=headway * rng.uniform(0.85, 1.25),
        phase=rng.uniform(0.0, 6.3),
    )


class WayCache:
    """A cache of ways: participants on the same path share one way."""

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], Way] = {}

    def along(self, path: Path, *, aside_m: float = 0.0) -> Way:
        """Return the way along a path."""
        key = (*path.lane_ids, round(aside_m, 2))
        if key not in self._known:
            self._known[key] = build_way([lane_piece(lane, aside_m=aside_m) for lane in path.lanes])
        return self._known[key]

    def changing(self, path: Path, network: Network, side: str) -> Way:
        """Return the way along a path with one change to the ``left`` or ``right`` lane, if there is room."""
        key = (*path.lane_ids, side)
        if key not in self._known:
            self._known[key] = build_way(_lane_change_pieces(path, network, side))
        return self._known[key]


def _lane_change_pieces(path: Path, network: Network, side: str) -> list[Piece]:
    names = [lane.left if side == "left" else lane.right for lane in path.lanes]
    for number, (lane, name) in enumerate(zip(path.lanes, names)):
        if name is None or lane.length_m < 2.0 * _CHANGE_M:
            continue
        pieces = [lane_piece(before) for before in path.lanes[:number]]
        pieces += change_lane_pieces(lane, network.lanes[name], 0.3 * lane.length_m, _CHANGE_M)
        onward = next(iterate_paths(select_lanes(network, "drive", "turn"), network.lanes[name]))
        return [*pieces, *(lane_piece(after) for after in onward.lanes[1:])]
    return [lane_piece(lane) for lane in path.lanes]


def make_vehicles(
    site: TrafficSite, bustle: TrafficDensity, until_s: float, ways: WayCache, rng: np.random.Generator
) -> Iterator[Participant]:
    """Make the vehicles of a traversal.

    Args:
        site: the scene.
        bustle: density of the traffic.
        until_s: latest time of entry.
        ways: cache of ways.
        rng: random numbers.
    """
    lanes = select_lanes(site.network, "drive", "turn")
    for start in source_lanes(lanes):
        if arrays.hypot(*start.line[0, :2]) < site.radius_m:
            continue
        per_hour = next(rate for speed, rate in _PER_HOUR if start.speed_mps < speed)
        motorway = start.speed_mps >= _MOTORWAY_MPS
        mean_s = 3600.0 / (per_hour * max(bustle.vehicles, 1e-3))
        time = rng.exponential(0.6 * mean_s)
        while time < until_s:
            kind = _draw_kind(start, motorway, rng)
            path = draw_path(lanes, start, rng, 3.5, least_bend_m=0.0 if kind in ("car", "motorcycle") else 9.0)
            sides = [side for side in ("left", "right") if any(getattr(lane, side) for lane in path.lanes)]
            if sides and kind != "truck" and rng.random() < _CHANGES:
                way = ways.changing(path, site.network, sides[int(rng.integers(len(sides)))])
            else:
                way = ways.along(path)
            yield _make_vehicle(kind, way, site, rng, time)
            time += _LEAST_HEADWAY_S + rng.exponential(max(mean_s - _LEAST_HEADWAY_S, 0.2))


def _draw_kind(start: Lane, motorway: bool, rng: np.random.Generator) -> Kind:
    mix = dict(_MOTORWAY_MIX if motorway else _MIX)
    if motorway and start.right is not None:
        mix["truck"] = 0.03
    if motorway and start.left is None:
        mix["truck"] = mix["bus"] = 0.0
    kinds, shares = list(mix), np.array(list(mix.values()))
    return kinds[int(rng.choice(len(kinds), p=shares / shares.sum()))]


def _make_vehicle(kind: Kind, way: Way, site: TrafficSite, rng: np.random.Generator, enter_s: float) -> Participant:
    number = int(rng.integers(POPULATION[kind]))
    length, width, _ = get_body(kind, number).size_m
    manner = draw_manner(kind, rng)
    aside = Aside(rng.uniform(-0.18, 0.18), rng.uniform(0.02, 0.07), rng.uniform(0.0, 6.3))
    pause_m, pause_s = -1.0, 0.0
    if kind == "bus":
        distances = [way.nearest_m(stop) for stop in site.bus_stops if way.gap_m(stop) < _BUS_STOP_M]
        if distances:
            pause_m, pause_s = distances[int(rng.integers(len(distances)))] + 4.0, rng.uniform(9.0, 16.0)
    chassis = Chassis.of_box(float(length), float(width))
    return Participant(kind, number, way, chassis, manner, aside, enter_s, pause_m=pause_m, pause_s=pause_s)


def make_cyclists(
    site: TrafficSite, bustle: TrafficDensity, until_s: float, ways: WayCache, rng: np.random.Generator
) -> Iterator[Participant]:
    """Make the cyclists of a traversal: on cycle lanes, and along the kerb of slow streets."""
    tracks, streets = select_lanes(site.network, "cycle", "turn"), select_lanes(site.network, "drive", "turn")
    starts = [(lane, tracks) for lane in source_lanes(tracks) if lane.use == "cycle"]
    starts += [(lane, streets) for lane in source_lanes(streets) if _TRACK_MPS <= lane.speed_mps < 9.0]
    for start, lanes in starts:
        mean_s = 3600.0 / (_CYCLES_PER_HOUR * max(bustle.people, 1e-3))
        time = rng.exponential(0.5 * mean_s)
        while time < until_s:
            path = draw_path(lanes, start, rng, 50.0)
            beside = lanes is streets
            aside = 0.5 * start.width_m - _KERB_M if beside else 0.0
            number = int(rng.integers(POPULATION["cyclist"]))
            length, width, _ = get_body("cyclist", number).size_m
            manner = Manner(1.0, rng.uniform(*_CYCLING_MPS), 0.8, 1.6, 0.8, rng.uniform(0.0, 6.3))
            keeps = Aside(0.0 if beside else rng.uniform(-0.35, 0.35), 0.05, rng.uniform(0.0, 6.3))
            chassis = Chassis.of_box(float(length), float(width))
            yield Participant("cyclist", number, ways.along(path, aside_m=aside), chassis, manner, keeps, time)
            time += 3.0 + rng.exponential(mean_s)


def make_leaving_cars(
    site: TrafficSite,
    places: list[tuple[Lane, float, int]],
    ways: WayCache,
    window_s: tuple[float, float],
    rng: np.random.Generator,
) -> Iterator[Participant]:
    """Make the parked cars that pull out and drive off.

    Args:
        site: the scene.
        places: lane, length along it of the middle of the car, and number of the car.
        ways: cache of ways.
        window_s: earliest and latest time.
        rng: random numbers.
    """
    drives = select_lanes(site.network, "drive")
    onward = select_lanes(site.network, "drive", "turn")
    for lane, at, number in places:
        length, width, _ = get_body("car", number).size_m
        place = np.array([np.interp(at, lane.along_m, lane.line[:, axis]) for axis in (0, 1)])
        beside = min(drives.values(), key=lambda drive: float(np.min(arrays.hypot(*(drive.line[:, :2] - place).T))))
        on = beside_m(beside, place)
        reach = 0.5 * float(length) + 16.0
        if beside.length_m - on < reach + 10.0 or lane.length_m - at < reach:
            continue
        path = draw_path(onward, beside, rng, 3.5)
        out = change_lane_pieces(lane, beside, at + 0.5 * float(length) + 2.0, 12.0)
        out[0] = lane_piece(lane, max(at - 0.5 * float(length), 0.0), at + 0.5 * float(length) + 14.0)
        way = build_way([*out, *(lane_piece(after) for after in path.lanes[1:])])
        front = min(at, 0.5 * float(length)) + 0.5 * float(length)
        yield Participant(
            "car",
            number,
            way,
            Chassis.of_box(float(length), float(width)),
            draw_manner("car", rng),
            Aside(),
            0.0,
            front,
            pause_m=front,
            pause_s=rng.uniform(*window_s),
        )
