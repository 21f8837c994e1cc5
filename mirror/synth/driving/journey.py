"""Simulates a journey: one drive of the recording vehicle through a scene, with all other road users."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.errors import MirrorError
from mirror.portable import arrays, scalars
from mirror.synth.driving.bodies import get_body
from mirror.synth.driving.drive import Drive
from mirror.synth.driving.parking import ParkedCar, place_parked_cars
from mirror.synth.driving.routes import DriveRoute, make_route
from mirror.synth.driving.site import TrafficDensity, TrafficSite
from mirror.synth.driving.vehicles import WayCache, make_cyclists, make_leaving_cars, make_vehicles
from mirror.synth.driving.walkers import make_walkers, place_standing_people
from mirror.synth.road_users.body import Body, RoadUser
from mirror.synth.seeds import name_seed, random_stream
from mirror.traffic.following.participants import Manner, Participant, simulate_participants
from mirror.traffic.following.simulation import TICK_S
from mirror.traffic.following.zones import find_zones
from mirror.traffic.lanes.ways import STEP_M
from mirror.traffic.placement.motion import Motion
from mirror.traffic.placement.overlaps import select_non_overlapping
from mirror.traffic.placement.trace import Aside, Chassis, Schedule, TraceMotion, build_trace

_WARM_UP_S: Final = 60.0
_LONGEST_S: Final = 240.0
_VISIBLE_M: Final = 60.0
_LEAVE: Final = 3
_CLEARANCE_M: Final = 0.04
_BESIDE_M: Final = 2.6
_BEYOND_M: Final = 12.0
_SETTLED_S: Final = 1.0
_PULL_OUT_M: Final = 12.0
_ATTEMPTS: Final = 4


@dataclass(frozen=True, eq=False)
class Journey:
    """One drive and the other road users.

    Attributes:
        drive: motion of the recording vehicle.
        road_users: all other road users, moving or parked; none overlaps another.
    """

    drive: Drive
    road_users: tuple[RoadUser, ...]


def simulate_journey(
    site: TrafficSite,
    route: str,
    chassis: Chassis,
    seed: int,
    *,
    scene_seed: int = 0,
    variant: int = 0,
    fastest_mps: float = 20.0,
    aside_m: float = 0.0,
    bustle: TrafficDensity | None = None,
) -> Journey:
    """Simulate a drive along a route through a scene with traffic.

    All road users are simulated together from a minute before the drive. The recording vehicle keeps its distance and
    waits at signals and for crossing pedestrians, and the others do the same for it. On routes that test a branch of
    the ROI trigger the recording vehicle keeps its times, and the others wait. If it does not finish within four
    minutes, the simulation is repeated with two thirds of the traffic.

    Args:
        site: the scene.
        route: a name in `mirror.synth.driving.routes.ROUTES`.
        chassis: chassis of the recording vehicle; its origin is the origin of the ego frame.
        seed: seed of the traversal's traffic.
        scene_seed: seed of the scene: the vehicles that are always parked.
        variant: variant of the route.
        fastest_mps: speed limit of the recording vehicle.
        aside_m: lateral offset of the recording vehicle to the right of its lane's middle.
        bustle: density of the traffic; default: a busy day.

    Raises:
        UsageError: the route does not exist.
        MirrorError: the vehicle does not finish the route.
    """
    chosen = make_route(route, site.network, site.radius_m, variant, chassis.wheelbase_m)
    bustle = TrafficDensity() if bustle is None else bustle
    for attempt in range(_ATTEMPTS):
        share = scalars.power(2.0 / 3.0, attempt)
        less = replace(bustle, vehicles=bustle.vehicles * share, people=bustle.people * share)
        journey = _attempt(site, route, chosen, chassis, random_stream("traffic", seed, attempt), scene_seed,
                         fastest_mps, aside_m, less)  # fmt: skip
        if journey is not None:
            return journey
    raise MirrorError(
        f"route {route!r} cannot be driven through within {_LONGEST_S:.0f} s",
        place=name_seed(seed),
        remedy="take another seed or less traffic",
    )


def _attempt(
    site: TrafficSite,
    name: str,
    route: DriveRoute,
    chassis: Chassis,
    rng: np.random.Generator,
    scene_seed: int,
    fastest_mps: float,
    aside_m: float,
    bustle: TrafficDensity,
) -> Journey | None:
    recorder = _recording_vehicle(route, chassis, rng, fastest_mps, aside_m)
    until = _WARM_UP_S + min(_longest_s(recorder), _LONGEST_S)
    ways = WayCache()
    cars = list(place_parked_cars(site, scene_seed, rng))
    off = _drop_blocking_cars(cars, rng)
    others = [
        *make_vehicles(site, bustle, until, ways, rng),
        *make_leaving_cars(site, [car.leaves for car in off if car.leaves], ways, (_WARM_UP_S, _WARM_UP_S + 50.0), rng),
        *make_cyclists(site, bustle, until, ways, rng),
    ]
    if route.first:
        others = _drop_near_route(route, others)
    on_foot = list(make_walkers(site, bustle, ways, rng))
    clock = float(rng.uniform(0.0, site.network.cycle_s))
    schedules = simulate_participants(
        site.network, [recorder, *others, *on_foot], clock, until, first_goes_first=route.first
    )
    ego = schedules[0]
    if ego is None or ego.along_m[-1] < route.end_m:
        return None
    start = ego.begin_s + _SETTLED_S if route.stands_s else ego.time_of(route.begin_m)
    duration = ego.time_of(route.end_m) - start
    trace = build_trace(route.way, chassis, site.height_m, recorder.aside)
    drive = Drive(name, trace, ego.since(start), duration, clock + start, recorder.manner.phase)
    moving = [
        (participant, schedule.since(start))
        for participant, schedule in zip([*others, *on_foot], schedules[1:])
        if schedule is not None and schedule.end_s > start and schedule.begin_s < start + duration
    ]
    removed = {id(car) for car in off}
    stays: list[tuple[Body, Motion]] = [(car.body, car.motion) for car in cars if id(car) not in removed]
    return Journey(
        drive,
        _make_road_users(site, chassis, drive, moving, stays, list(place_standing_people(site, bustle, rng)), bustle),
    )


def _recording_vehicle(
    route: DriveRoute, chassis: Chassis, rng: np.random.Generator, fastest_mps: float, aside_m: float
) -> Participant:
    """The recording vehicle."""
    manner = Manner(
        eager=rng.uniform(0.93, 1.03),
        fastest_mps=min(fastest_mps, route.fastest_mps),
        pick_up_mps2=rng.uniform(1.4, 1.9),
        brake_mps2=rng.uniform(1.6, 2.0),
        headway_s=rng.uniform(1.2, 1.6),
        phase=rng.uniform(0.0, 6.3),
    )
    aside = Aside(aside_m, rng.uniform(0.03, 0.07), rng.uniform(0.0, 6.3))
    stands = route.stands_s > 0.0
    return Participant(
        "car", 0, route.way, chassis, manner, aside,
        enter_s=_WARM_UP_S,
        enter_m=route.comes_from_m,
        end_m=min(route.end_m + _BEYOND_M, route.way.length_m),
        pause_m=route.begin_m if stands else -1.0,
        pause_s=route.stands_s,
    )  # fmt: skip


def _longest_s(recorder: Participant) -> float:
    """Upper limit of the duration of the drive."""
    stretch = recorder.way.pace_mps[
        int(recorder.enter_m / STEP_M) : int((recorder.end_m or recorder.way.length_m) / STEP_M)
    ]
    return 40.0 + recorder.pause_s + 3.0 * float((STEP_M / np.minimum(stretch, recorder.manner.fastest_mps)).sum())


def _drop_blocking_cars(cars: Sequence[ParkedCar], rng: np.random.Generator) -> list[ParkedCar]:
    """Select cars to drive off among those that may and that have room to pull out."""
    movable = [car for car in cars if car.leaves is not None and not any(_is_blocking(car, other) for other in cars)]
    return [movable[int(place)] for place in rng.permutation(len(movable))[:_LEAVE]]


def _is_blocking(car: ParkedCar, other: ParkedCar) -> bool:
    """Return whether another car is parked directly in front of a car."""
    place, other_place = car.motion.placement, other.motion.placement
    dx, dy = other_place.x_m - place.x_m, other_place.y_m - place.y_m
    cos, sin = scalars.cos(place.yaw_rad), scalars.sin(place.yaw_rad)
    return 1.0 < cos * dx + sin * dy < _PULL_OUT_M and abs(cos * dy - sin * dx) < 1.5


def _drop_near_route(route: DriveRoute, others: Sequence[Participant]) -> list[Participant]:
    """Participants that never drive ahead of the recording vehicle on a route that has to keep its times."""
    follows: dict[int, bool] = {}
    for other in others:
        if id(other.way) not in follows:
            follows[id(other.way)] = any(
                zone.along and zone.begin_m[0] < route.end_m and zone.end_m[0] > route.comes_from_m
                for zone in find_zones(route.way, other.way, _BESIDE_M)
            )
    return [other for other in others if not follows[id(other.way)]]


def _make_road_users(
    site: TrafficSite,
    chassis: Chassis,
    drive: Drive,
    moving: Sequence[tuple[Participant, Schedule]],
    parked_cars: Sequence[tuple[Body, Motion]],
    standing_people: Sequence[tuple[Body, Motion]],
    bustle: TrafficDensity,
) -> tuple[RoadUser, ...]:
    """All road users, without those that would overlap one of higher priority."""
    driven: list[tuple[Body, Motion]] = []
    walking: list[tuple[Body, Motion]] = []
    for participant, schedule in moving:
        on_foot = participant.kind == "pedestrian"
        body = get_body(participant.kind, participant.number, bustle.umbrellas and on_foot, bustle.warm and on_foot)
        moves = TraceMotion(
            build_trace(participant.way, participant.chassis, site.height_m, participant.aside), schedule
        )
        (walking if on_foot else driven).append((body, moves))
    everybody = [*driven, *parked_cars, *walking, *standing_people]
    times = np.arange(0.0, drive.duration_s + TICK_S, TICK_S)
    places = np.empty((len(everybody) + 1, len(times), 3))
    places[0] = _vehicle_centres(drive, chassis, times)
    for number, (_, motion) in enumerate(everybody, start=1):
        if isinstance(motion, TraceMotion):
            poses, _ = motion.trace.at(motion.schedule.at(times)[0])
            places[number] = poses[:, (0, 1, 3)]
        else:
            at = motion.at(0.0)
            places[number] = (at.x_m, at.y_m, at.yaw_rad)
    sizes = np.array([(chassis.length_m, chassis.width_m), *(body.size_m[:2] for body, _ in everybody)])
    fixed = np.zeros(len(places), np.bool_)
    fixed[0] = True
    is_kept = select_non_overlapping(places, 0.5 * sizes + _CLEARANCE_M, fixed, site.radius_m + _VISIBLE_M)
    counts: dict[str, int] = {}
    road_users = []
    for (body, motion), stays in zip(everybody, is_kept[1:]):
        if stays:
            counts[body.category] = counts.get(body.category, 0) + 1
            road_users.append(RoadUser(f"{body.category}-{counts[body.category]:03d}", body, motion))
    return tuple(road_users)


def _vehicle_centres(drive: Drive, chassis: Chassis, times: Float64) -> Float64:
    """(T, 3) x, y and yaw of the middle of the recording vehicle."""
    poses, _ = drive.trace.at(drive.schedule.at(times)[0])
    ahead = 0.5 * chassis.length_m - chassis.rear_overhang_m - chassis.origin_m
    yaw = poses[:, 3]
    return np.column_stack([poses[:, 0] + ahead * arrays.cos(yaw), poses[:, 1] + ahead * arrays.sin(yaw), yaw])
