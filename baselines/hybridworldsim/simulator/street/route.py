"""The ego's start and route on a street."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hybridworldsim.simulator.agents.on_ways import WayHalt
from hybridworldsim.simulator.ego.vehicle import EgoState
from hybridworldsim.simulator.street.street import Street
from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.schema.road_map import MapLane, RoadMap
from mirror.schema.scenario import EgoPlan, LaneStart, PoseStart, Turn
from mirror.traffic.lanes.ways import STEP_M, Piece, Way, build_way

DEFAULT_LIMIT_MPS: Final = 13.9
"""Speed limit of a lane whose limit is not known."""
_MOST_LANES: Final = 40
_NAMED_LANES: Final = 8
_OFF_ROUTE_M: Final = 5.0
_AIMS: Final[dict[Turn, float]] = {"straight": 0.0, "left": 0.5 * math.pi, "right": -0.5 * math.pi}


@dataclass(frozen=True, eq=False)
class RoutePlan:
    """The ego's planned route.

    Attributes:
        way: its line, from the beginning of its first lane.
        lanes: ids of its lanes.
        halts: stop lines on it.
        begin_m: length along the way at which the ego's rear axle starts.
    """

    way: Way
    lanes: tuple[str, ...]
    halts: tuple[WayHalt, ...]
    begin_m: float


def plan_route(street: Street, plan: EgoPlan) -> tuple[EgoState, RoutePlan, str, float]:
    """Place the ego and plan its route.

    Returns:
        The ego's state, its route, the recording whose time is used, and the time in it at the start.

    Raises:
        UsageError: a lane or a recording does not exist, or the start is not on the map.
    """
    start = plan.start
    recording = _recording(street, getattr(start, "traversal", None))
    if isinstance(start, LaneStart):
        lanes, begin = _lane_start(street, plan, start)
        route = route_along(street.road_map, lanes, begin)
        x, y, yaw = pose_on(route.way, begin)
        return EgoState(x, y, yaw, plan.speed_mps), route, recording, 0.0
    if isinstance(start, PoseStart):
        pose = np.array([start.x_m, start.y_m, math.radians(start.yaw_deg)])
        speed, after = plan.speed_mps, 0.0
    else:
        recorded = street.recordings[recording]
        after = start.after_s
        if after > recorded.times_s[-1]:
            raise UsageError(
                f"the recording {recording} lasts {recorded.times_s[-1]:.1f} s", place="ego.start.after_s",
                expected=f"less, not {after:g}",
            )  # fmt: skip
        yaw_line = np.unwrap(recorded.poses[:, 2])
        pose = np.array([np.interp(after, recorded.times_s, line) for line in (*recorded.poses[:, :2].T, yaw_line)])
        ends = np.clip([after - 0.1, after + 0.1], 0.0, recorded.times_s[-1])
        places = [[np.interp(end, recorded.times_s, line) for line in recorded.poses[:, :2].T] for end in ends]
        speed = float(np.hypot(*np.subtract(places[1], places[0])) / (ends[1] - ends[0]))
    first, along = _nearest_lane(street.road_map, pose)
    lanes = plan.route.lanes or tuple(_onward(street.road_map, first, plan.route.turns))
    route = route_along(street.road_map, lanes, along)
    on_way = route.way.nearest_m(pose[:2])
    x, y, yaw = pose.tolist()
    return EgoState(x, y, yaw, speed), RoutePlan(route.way, lanes, route.halts, on_way), recording, after


def route_along(road_map: RoadMap, lanes: tuple[str, ...], begin_m: float) -> RoutePlan:
    """Make the route along lanes."""
    unknown = next((name for name in lanes if name not in road_map.lanes), None)
    if unknown is not None:
        raise _no_lane(road_map, unknown, "ego.route.lanes")
    members = [road_map.lanes[name] for name in lanes]
    broken = next((pair for pair in itertools.pairwise(members) if pair[1].lane_id not in pair[0].successors), None)
    if broken is not None:
        raise UsageError(
            f"lane {broken[1].lane_id!r} does not follow {broken[0].lane_id!r}", place="ego.route.lanes",
            expected="lanes of which each leads to the next",
        )  # fmt: skip
    return RoutePlan(way_along(members), lanes, halts_along(members), begin_m)


def _no_lane(road_map: RoadMap, name: str, place: str) -> UsageError:
    known = sorted(road_map.lanes)
    more = f" or one of {len(known) - _NAMED_LANES} others" if len(known) > _NAMED_LANES else ""
    return UsageError(
        f"there is no lane {name!r} on the map", place=place,
        expected=f"one of its lanes: {', '.join(known[:_NAMED_LANES])}{more}",
        remedy="leave the key out: the ego then takes the longest way straight on",
    )  # fmt: skip


def way_along(lanes: list[MapLane]) -> Way:
    """Return the smooth line along lanes."""
    return build_way([Piece(lane.center_m[:, :2], lane.speed_limit_mps or DEFAULT_LIMIT_MPS) for lane in lanes])


def halts_along(lanes: list[MapLane]) -> tuple[WayHalt, ...]:
    """Return the stop lines with signals along lanes."""
    halts, before = [], 0.0
    for lane in lanes:
        if lane.signal is not None and lane.stop_m is not None:
            halts.append(WayHalt(before + lane.stop_m, lane.signal))
        before += lane.length_m
    return tuple(halts)


def pose_on(way: Way, along_m: float) -> tuple[float, float, float]:
    """Return x, y and heading of a way at a length."""
    x, y, heading = poses_on(way, np.array(along_m))
    return float(x), float(y), float(heading)


def poses_on(way: Way, along_m: Float64) -> tuple[Float64, Float64, Float64]:
    """Return x, y and heading of a way at lengths, in arrays of the lengths' shape."""
    place = STEP_M * np.arange(len(way.points))
    x, y, heading = (np.interp(along_m, place, values) for values in (*way.points.T, way.heading_rad))
    return x, y, heading


def onward_lanes(road_map: RoadMap, first: str, rng: np.random.Generator | None = None) -> tuple[str, ...]:
    """Return the lanes onward from a lane: straight on, or with random turns."""
    return tuple(_onward(road_map, first, (), rng))


def _lane_start(street: Street, plan: EgoPlan, start: LaneStart) -> tuple[tuple[str, ...], float]:
    road_map = street.road_map
    if plan.route.lanes:
        return plan.route.lanes, start.along_m
    if start.lane is not None:
        if start.lane not in road_map.lanes:
            raise _no_lane(road_map, start.lane, "ego.start.lane")
        lane = road_map.lanes[start.lane]
        if start.along_m > lane.length_m:
            raise UsageError(
                f"lane {start.lane!r} is {lane.length_m:.1f} m long", place="ego.start.along_m",
                expected=f"less, not {start.along_m:g}",
            )  # fmt: skip
        return tuple(_onward(road_map, start.lane, plan.route.turns)), start.along_m
    # Of a recorded map, only what was driven was recorded by cameras too.
    is_shown = street.is_inside if street.drive is not None or road_map.fitted else street.is_driven
    candidates = []
    for lane in road_map.lanes_of(("drive",)):
        lanes = tuple(_onward(road_map, lane.lane_id, plan.route.turns))
        points = way_along([road_map.lanes[name] for name in lanes]).points
        inside = np.flatnonzero(is_shown(points))
        if len(inside):
            candidates.append((len(inside), lane.lane_id, lanes, STEP_M * float(inside[0])))
    if not candidates:
        raise UsageError(
            "no driving lane leads through the part of the street that was recorded", place="ego.start",
            expected="a map with driving lanes along the recorded lines, or a start that names a lane",
        )  # fmt: skip
    _, _, lanes, begin = min(candidates, key=lambda row: (-row[0], row[1]))
    return lanes, begin + start.along_m


def _onward(
    road_map: RoadMap, first: str, turns: tuple[Turn, ...], rng: np.random.Generator | None = None
) -> list[str]:
    lanes, left = [first], list(turns)
    while len(lanes) < _MOST_LANES:
        following = [name for name in road_map.lanes[lanes[-1]].successors if name not in lanes]
        if not following:
            break
        if rng is not None:
            lanes.append(following[int(rng.integers(len(following)))])
            continue
        aim = 0.0
        if len(following) > 1 and left:
            aim = _AIMS[left.pop(0)]
        lanes.append(min(following, key=lambda name: (round(abs(_turn(road_map.lanes[name]) - aim), 6), name)))
    return lanes


def _turn(lane: MapLane) -> float:
    steps = np.diff(lane.center_m[:, :2], axis=0)
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    return float(headings[-1] - headings[0])


def _nearest_lane(road_map: RoadMap, pose: Float64) -> tuple[str, float]:
    best: tuple[float, str, float] | None = None
    for lane in road_map.lanes_of():
        points = lane.center_m[:, :2]
        distance = np.hypot(*(points - pose[:2]).T)
        nearest = int(distance.argmin())
        ahead = points[min(nearest + 1, len(points) - 1)] - points[max(nearest - 1, 0)]
        if ahead @ (math.cos(pose[2]), math.sin(pose[2])) <= 0.0:
            continue
        if best is None or (distance[nearest], lane.lane_id) < best[:2]:
            best = float(distance[nearest]), lane.lane_id, float(lane.along_m[nearest])
    if best is None or best[0] > _OFF_ROUTE_M:
        raise UsageError(
            f"the start ({pose[0]:.1f}, {pose[1]:.1f}) is not on a driving lane", place="ego.start",
            expected=f"a pose at most {_OFF_ROUTE_M:g} m from a lane of its direction",
        )  # fmt: skip
    return best[1], best[2]


def _recording(street: Street, traversal: str | None) -> str:
    if traversal is None:
        return min(street.recordings)
    if traversal not in street.recordings:
        raise UsageError(
            f"there is no traversal {traversal!r}", place="ego.start.traversal",
            expected=f"one of {', '.join(street.recordings)}",
        )  # fmt: skip
    return traversal
