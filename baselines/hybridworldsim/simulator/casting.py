"""The agents of a scenario on a street: where each one starts, and what it will do."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final

import numpy as np

from hybridworldsim.simulator.agents.attack import AttackPlan
from hybridworldsim.simulator.agents.bodies import draw_body
from hybridworldsim.simulator.agents.groups import AgentGroup
from hybridworldsim.simulator.agents.on_ways import AgentsOnWays, WayAgent, WayHalt
from hybridworldsim.simulator.agents.replay import ReplayedAgents
from hybridworldsim.simulator.agents.scripts import Script
from hybridworldsim.simulator.agents.states import Agent
from hybridworldsim.simulator.ego.vehicle import EgoState
from hybridworldsim.simulator.street.obstacles import Walls, check_free
from hybridworldsim.simulator.street.route import (
    RoutePlan,
    halts_along,
    onward_lanes,
    pose_on,
    poses_on,
    way_along,
)
from hybridworldsim.simulator.street.street import Street
from mirror.arrays import Bool, Float64
from mirror.errors import UsageError
from mirror.metrics.safety import inside_area
from mirror.schema.behaviours import (
    Attack,
    CrossingPedestrian,
    CutIn,
    HardBrake,
    Idm,
    OncomingOvertake,
    PullOut,
    Replay,
    StoppedQueue,
    Trigger,
)
from mirror.schema.scenario import Scenario, ScenarioAgent
from mirror.traffic.following.participants import Manner
from mirror.traffic.lanes.ways import STEP_M, Piece, Way, build_way

_FASTEST_MPS: Final = 60.0
_STANDING_GAP_M: Final = 6.0
_HALF_LANE_M: Final = 1.6
_TRIES: Final = (8, 192)
"""Places that are drawn for an agent: most agents find room at one of the first."""


@dataclass(frozen=True, eq=False)
class Stage:
    """The street and the ego's plan, from which agents are cast.

    Attributes:
        street: the street.
        scenario: the scenario.
        ego: the ego at the start.
        route: the ego's route.
        recording: the recording whose road users are replayed.
        start_s: time in it at the start.
        seed: seed of the rollout.
        ways: ways along lanes that were built, by the ids of the lanes.
        places: places of the lanes near the ego that agents may start at, by the distance.
    """

    street: Street
    scenario: Scenario
    ego: EgoState
    route: RoutePlan
    recording: str
    start_s: float
    seed: int
    ways: dict[tuple[str, ...], tuple[Way, tuple[WayHalt, ...]]] = field(default_factory=dict)
    places: dict[float, list[tuple[str, float]]] = field(default_factory=dict)

    @property
    def ego_front_m(self) -> float:
        """Length of the ego's front end along its route."""
        vehicle = self.street.vehicle
        return self.route.begin_m + vehicle.rear_axle_to_center_m + 0.5 * vehicle.length_m


def cast_agents(stage: Stage) -> list[AgentGroup]:
    """Return the groups of agents of a scenario.

    Raises:
        UsageError: a track is unknown, an agent does not fit on the street, or it starts in a wall or in another actor.
    """
    replayed: list[AgentGroup] = []
    on_ways: list[WayAgent] = []
    taken = [_ego_box(stage)]
    for entry in stage.scenario.agents:
        if isinstance(entry.behaviour, Replay):
            replayed.append(_replayed(stage, entry.id, entry.behaviour, entry.behaviour.tracks))
            continue
        for member in _members(stage, entry, taken):
            taken.append(_box(member))
            on_ways.append(member)
    walls = Walls.of(stage.street)
    for member in on_ways:
        check_free(stage.street, walls, member.agent.agent_id, member.agent.category, _box(member))
    street, step_s = stage.street, 1.0 / stage.scenario.rate_hz

    # All halts are asked about at one time.
    signals = lru_cache(maxsize=1)(street.signals)

    def is_red(signal_id: str, time_s: float) -> bool:
        return signals(time_s).get(signal_id, "green") != "green"

    def is_drivable(points: Float64) -> bool:
        return bool(inside_area(points, street.road_map.drivable_rings).all())

    group = AgentsOnWays(on_ways, stage.route.way, stage.seed, step_s, is_red=is_red, is_drivable=is_drivable)
    return [*replayed, group]


def _replayed(stage: Stage, prefix: str, behaviour: Replay, names: tuple[str, ...] | None) -> ReplayedAgents:
    recording = stage.street.recordings[stage.recording]
    known = {track.agent.agent_id: track for track in recording.tracks}
    missing = next((name for name in names or () if name not in known), None)
    if missing is not None:
        raise UsageError(
            f"recording {stage.recording} has no road user {missing!r}", place=f"agent {prefix!r}",
            expected=f"one of {', '.join(sorted(known)[:12])} ..." if known else "a recording with boxes",
        )  # fmt: skip
    tracks = [
        replace(track, agent=replace(track.agent, agent_id=f"{prefix}-{name}"))
        for name, track in sorted(known.items())
        if names is None or name in names
    ]
    return ReplayedAgents(tracks, stage.start_s, 1.0 / stage.scenario.rate_hz, stage.scenario.steps)


def _members(stage: Stage, entry: ScenarioAgent, taken: list[Float64]) -> Iterator[WayAgent]:
    place = f"agent {entry.id!r}"
    for number in range(entry.count):
        agent_id = entry.id if entry.count == 1 else f"{entry.id}-{number}"
        body = draw_body(entry.category, agent_id, stage.seed)
        agent = Agent(agent_id, entry.category, body.size_m, body)
        behaviour = entry.behaviour
        if isinstance(behaviour, Idm) and behaviour.ahead_m is None:
            member = _drawn(stage, agent, behaviour, taken)
            if member is not None:
                yield member
            continue
        if isinstance(behaviour, Replay):
            raise UsageError("a replayed agent has no way", place=place)
        yield _CASTS[behaviour.kind](stage, agent, behaviour, number)


def _ahead(stage: Stage, agent: Agent, gap_m: float) -> float:
    """Length of the front end of an agent whose rear is a gap ahead of the ego's front."""
    front = stage.ego_front_m + gap_m + agent.size_m[0]
    if front > stage.route.way.length_m:
        raise UsageError(
            f"{front - stage.ego_front_m:.0f} m ahead of the ego is off its route, which ends after "
            f"{stage.route.way.length_m - stage.ego_front_m:.0f} m",
            place=f"agent {agent.agent_id!r}", expected="a place on the route",
            remedy="let the agent start nearer, or the ego earlier on its route",
        )  # fmt: skip
    return front


def _on_route(
    stage: Stage, agent: Agent, gap_m: float, speed_mps: float, aside_m: float = 0.0, script: Script | None = None,
    *, parked: bool = False, attack: AttackPlan | None = None, manner: Manner | None = None,
) -> WayAgent:  # fmt: skip
    return WayAgent(
        agent, stage.route.way, _ahead(stage, agent, gap_m), speed_mps, aside_m, stage.route.halts, script, parked,
        attack, manner,
    )  # fmt: skip


def _idm(stage: Stage, agent: Agent, behaviour: Idm, number: int) -> WayAgent:
    manner = _manner(behaviour)
    gap = behaviour.ahead_m or 0.0
    speed = behaviour.speed_mps
    if speed is None:
        speed = float(_pace(stage.route.way, np.array(stage.ego_front_m + gap), manner))
    return _on_route(stage, agent, gap, speed, manner=manner)


def _drawn(stage: Stage, agent: Agent, behaviour: Idm, taken: list[Float64]) -> WayAgent | None:
    """An agent at a free place on the lanes near the ego, drawn from the seed; None: there is no room."""
    digest = hashlib.sha256(f"place/{stage.seed}/{agent.agent_id}".encode()).digest()
    rng = np.random.default_rng(int.from_bytes(digest[:8], "little"))
    places = _places(stage, behaviour.radius_m)
    manner = _manner(behaviour)
    others = np.array(taken)
    for count in _TRIES if places else ():
        tries = []
        for _ in range(count):
            lane_id, along = places[int(rng.integers(len(places)))]
            tries.append((onward_lanes(stage.street.road_map, lane_id, rng), along + agent.size_m[0]))
        free = _first_free(stage, agent, behaviour.speed_mps, manner, tries, others)
        if free is not None:
            return free
    return None


def _first_free(
    stage: Stage, agent: Agent, speed_mps: float | None, manner: Manner,
    tries: list[tuple[tuple[str, ...], float]], others: Float64,
) -> WayAgent | None:  # fmt: skip
    """The agent at the first of some starts (lanes and length of its front along them) that is on a way and free."""
    rows_of: dict[tuple[str, ...], list[int]] = {}
    for row, (names, _) in enumerate(tries):
        rows_of.setdefault(names, []).append(row)
    fronts, boxes, speeds = np.array([front for _, front in tries]), np.empty((len(tries), 5)), np.empty(len(tries))
    is_free = np.empty(len(tries), np.bool_)
    for names, rows in rows_of.items():
        way, front = _way_from(stage, names)[0], fronts[rows]
        boxes[rows] = _boxes(agent, way, front, 0.0)
        speeds[rows] = _pace(way, front, manner) if speed_mps is None else speed_mps
        is_free[rows] = front < way.length_m
    is_free &= ~_is_near(boxes, others, 0.8 * speeds)
    if not is_free.any():
        return None
    first = int(is_free.argmax())
    way, halts = _way_from(stage, tries[first][0])
    return WayAgent(agent, way, tries[first][1], float(speeds[first]), 0.0, halts, manner=manner)


def _places(stage: Stage, radius_m: float) -> list[tuple[str, float]]:
    """The places of driving lanes within a distance of the ego: lanes and lengths along them."""
    if radius_m not in stage.places:
        ego = np.array([stage.ego.x_m, stage.ego.y_m])
        found = stage.places[radius_m] = []
        for lane in sorted(stage.street.road_map.lanes_of(("drive",)), key=lambda lane: lane.lane_id):
            near = np.hypot(*(lane.center_m[:, :2] - ego).T) < radius_m
            near &= stage.street.is_inside(lane.center_m[:, :2])
            found += [(lane.lane_id, float(along)) for along in lane.along_m[near]]
    return stage.places[radius_m]


def _way_from(stage: Stage, names: tuple[str, ...]) -> tuple[Way, tuple[WayHalt, ...]]:
    """The way along lanes and its stop lines."""
    if names not in stage.ways:
        members = [stage.street.road_map.lanes[name] for name in names]
        stage.ways[names] = way_along(members), halts_along(members)
    return stage.ways[names]


def _is_near(boxes: Float64, others: Float64, gap_m: Float64) -> Bool:
    """For each box, whether one of the others is in its lane, or touches it nearly, within a gap before or behind."""
    cos, sin = np.cos(boxes[:, 2, None]), np.sin(boxes[:, 2, None])
    dx, dy = others[:, 0] - boxes[:, 0, None], others[:, 1] - boxes[:, 1, None]
    along, aside = np.abs(cos * dx + sin * dy), np.abs(cos * dy - sin * dx)
    near: Bool = along < gap_m[:, None] + _STANDING_GAP_M + others[:, 3]
    near &= aside < boxes[:, 4, None] + np.maximum(others[:, 4], _HALF_LANE_M)
    return np.logical_or.reduce(near, axis=1)


def _cut_in(stage: Stage, agent: Agent, behaviour: CutIn, number: int) -> WayAgent:
    sign = 1.0 if behaviour.side == "left" else -1.0
    offset = _lane_offset(stage, behaviour.ahead_m, sign, behaviour.offset_m)
    script = Script(
        behaviour.trigger.ttc_s, _latest(behaviour.trigger), shift_m=-sign * offset, shift_s=behaviour.change_s
    )
    return _on_route(stage, agent, behaviour.ahead_m, behaviour.speed_mps, sign * offset, script)


def _hard_brake(stage: Stage, agent: Agent, behaviour: HardBrake, number: int) -> WayAgent:
    script = Script(
        behaviour.trigger.ttc_s, _latest(behaviour.trigger), speed_mps=0.0,
        acceleration_mps2=behaviour.deceleration_mps2, stands=True,
    )  # fmt: skip
    return _on_route(stage, agent, behaviour.ahead_m, behaviour.speed_mps, script=script)


def _pedestrian(stage: Stage, agent: Agent, behaviour: CrossingPedestrian, number: int) -> WayAgent:
    at = stage.ego_front_m + behaviour.ahead_m
    _ahead(stage, agent, behaviour.ahead_m)
    x, y, heading = pose_on(stage.route.way, at)
    sign = 1.0 if behaviour.side == "left" else -1.0
    left = np.array([-math.sin(heading), math.cos(heading)])
    shares = np.linspace(sign * behaviour.offset_m, -sign * (behaviour.offset_m + 20.0), 120)
    way = build_way([Piece(np.array([x, y]) + shares[:, None] * left, 3.0)])
    script = Script(
        behaviour.trigger.ttc_s, _latest(behaviour.trigger), speed_mps=behaviour.speed_mps, stands=True, is_line=True
    )
    return WayAgent(agent, way, 0.5 * agent.size_m[0], 0.0, script=script, parked=True)


def _oncoming(stage: Stage, agent: Agent, behaviour: OncomingOvertake, number: int) -> WayAgent:
    offset = _lane_offset(stage, behaviour.ahead_m, 1.0, behaviour.offset_m)
    points = stage.route.way.points[::-1]
    way = build_way([Piece(points, 50.0)])
    at = stage.route.way.length_m - stage.ego_front_m - behaviour.ahead_m
    if at < agent.size_m[0]:
        _ahead(stage, agent, behaviour.ahead_m)
    script = Script(
        behaviour.trigger.ttc_s, _latest(behaviour.trigger), shift_m=offset, shift_s=behaviour.change_s,
        stay_s=behaviour.stay_s,
    )  # fmt: skip
    return WayAgent(agent, way, at, behaviour.speed_mps, -offset, script=script)


def _pull_out(stage: Stage, agent: Agent, behaviour: PullOut, number: int) -> WayAgent:
    sign = 1.0 if behaviour.side == "left" else -1.0
    script = Script(
        behaviour.trigger.ttc_s, _latest(behaviour.trigger), speed_mps=behaviour.speed_mps,
        acceleration_mps2=behaviour.acceleration_mps2, shift_m=-sign * behaviour.offset_m, shift_s=behaviour.change_s,
        stands=True,
    )  # fmt: skip
    return _on_route(stage, agent, behaviour.ahead_m, 0.0, sign * behaviour.offset_m, script, parked=True)


def _queue(stage: Stage, agent: Agent, behaviour: StoppedQueue, number: int) -> WayAgent:
    # Bodies differ in length: each place has room for the longest of its kind, so that no gap depends on the others.
    gap = behaviour.ttc_s * stage.ego.speed_mps + number * (behaviour.spacing_m + _longest(agent))
    return _on_route(stage, agent, max(gap, behaviour.spacing_m), 0.0, parked=True)


def _attack(stage: Stage, agent: Agent, behaviour: Attack, number: int) -> WayAgent:
    sign = 1.0 if behaviour.side == "left" else -1.0
    plan = AttackPlan(
        behaviour.trigger.ttc_s, _latest(behaviour.trigger), behaviour.evaluations, behaviour.horizon_s,
        behaviour.max_acceleration_mps2, behaviour.max_lateral_acceleration_mps2, stage.seed,
    )  # fmt: skip
    return _on_route(stage, agent, behaviour.ahead_m, behaviour.speed_mps, sign * behaviour.offset_m, attack=plan)


_CASTS: Final[dict[str, Callable[..., WayAgent]]] = {
    "idm": _idm,
    "cut-in": _cut_in,
    "hard-brake": _hard_brake,
    "crossing-pedestrian": _pedestrian,
    "oncoming-overtake": _oncoming,
    "pull-out": _pull_out,
    "stopped-queue": _queue,
    "attack": _attack,
}


def _latest(trigger: Trigger) -> float:
    return math.inf if trigger.latest_s is None else trigger.latest_s


def _lane_offset(stage: Stage, ahead_m: float, sign: float, default_m: float) -> float:
    """Distance to the driving lane beside the ego's, of either direction; the default where there is none."""
    at = min(stage.ego_front_m + ahead_m, stage.route.way.length_m)
    x, y, heading = pose_on(stage.route.way, at)
    left = np.array([-math.sin(heading), math.cos(heading)])
    offsets = []
    for lane in stage.street.road_map.lanes_of(("drive",)):
        difference = lane.center_m[:, :2] - (x, y)
        nearest = int(np.hypot(*difference.T).argmin())
        offset, along = sign * float(difference[nearest] @ left), float(np.abs(difference[nearest]) @ np.abs(left))
        if 2.2 < offset < 1.6 * default_m and np.hypot(*difference[nearest]) < 1.05 * offset + 0.5 and along > 0.0:
            offsets.append(offset)
    return min(offsets, default=default_m)


def _manner(behaviour: Idm) -> Manner:
    return Manner(
        eager=behaviour.desired_share,
        fastest_mps=_FASTEST_MPS,
        pick_up_mps2=behaviour.max_acceleration_mps2,
        brake_mps2=behaviour.comfortable_deceleration_mps2,
        headway_s=behaviour.headway_s,
    )


def _pace(way: Way, along_m: Float64, manner: Manner) -> Float64:
    return manner.eager * np.interp(along_m, STEP_M * np.arange(len(way.points)), way.pace_mps)


def _longest(agent: Agent) -> float:
    return {"car": 5.2, "van": 6.2, "truck": 12.0, "bus": 13.0}.get(agent.category, agent.size_m[0])


def _box(member: WayAgent) -> Float64:
    """x, y, yaw, half length and half width of an agent at the start."""
    return _boxes(member.agent, member.way, np.array([member.front_m]), member.aside_m)[0]


def _boxes(agent: Agent, way: Way, front_m: Float64, aside_m: float) -> Float64:
    """(N, 5) boxes of an agent at the lengths (N,) of its front along a way: x, y, yaw, half length, half width."""
    x, y, yaw = poses_on(way, front_m - 0.5 * agent.size_m[0])
    half = np.broadcast_to(0.5 * np.array(agent.size_m[:2]), (len(x), 2))
    return np.column_stack([x - aside_m * np.sin(yaw), y + aside_m * np.cos(yaw), yaw, half])


def _ego_box(stage: Stage) -> Float64:
    from hybridworldsim.simulator.ego.vehicle import center_position

    vehicle = stage.street.vehicle
    x, y = center_position(vehicle, stage.ego)
    return np.array([x, y, stage.ego.yaw_rad, 0.5 * vehicle.length_m, 0.5 * vehicle.width_m])
