"""A rollout of a scenario on a street, step by step, without images."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from hybridworldsim.simulator.agents.groups import AllAgents
from hybridworldsim.simulator.casting import Stage, cast_agents
from hybridworldsim.simulator.ego.tracker import TrajectoryTracker
from hybridworldsim.simulator.ego.trajectory import Trajectory
from hybridworldsim.simulator.ego.vehicle import Controls
from hybridworldsim.simulator.policies.protocol import (
    ROUTE_POINTS,
    ROUTE_STEP_M,
    Action,
    CameraSpec,
    NoPlanYet,
    Observation,
    ObservationSpec,
    PlannedTrajectory,
    PrivilegedState,
)
from hybridworldsim.simulator.street.obstacles import corners_of
from hybridworldsim.simulator.street.route import RoutePlan, plan_route
from hybridworldsim.simulator.street.street import Street
from hybridworldsim.simulator.world import SimulatedWorld, Snapshot, StateRecorder, state_log
from mirror.arrays import Float64, Int64, UInt8
from mirror.errors import UsageError
from mirror.metrics.safety import find_collisions, inside_area
from mirror.schema.rollout import Ending
from mirror.schema.scenario import RecordedStart, Scenario

if TYPE_CHECKING:
    from torch import Tensor

_STREET_MARGIN_M: Final = 60.0
_NO_PLAN_S: Final = 4.0


@dataclass(eq=False)
class Simulation:
    """A running rollout.

    Attributes:
        street: the street.
        scenario: the scenario.
        route: the ego's route.
        seed: seed of the rollout.
        world: the world.
        recorder: the states so far.
        stops_at_collision: whether a contact of the ego ends the rollout.
        recorded: recorded trajectory of the ego in the times of the rollout; None: the ego does not start on it.
        ends_off_road: whether the rollout ends where the whole body of the ego is off the drivable area.
    """

    street: Street
    scenario: Scenario
    route: RoutePlan
    seed: int
    world: SimulatedWorld
    recorder: StateRecorder
    stops_at_collision: bool = True
    recorded: Trajectory | None = None
    ends_off_road: bool = False

    def __post_init__(self) -> None:
        self._tracker = TrajectoryTracker(self.street.vehicle, self.step_s)
        self._controls = Controls(0.0, 0.0)
        self._trajectory: Trajectory | None = None
        self._rings = self.street.road_map.drivable_rings

    @property
    def step_s(self) -> float:
        """Duration of a step."""
        return 1.0 / self.scenario.rate_hz

    @property
    def controls(self) -> Controls:
        """The target controls of the last step."""
        return self._controls

    @property
    def now(self) -> Snapshot:
        """The present state."""
        return self.world.now

    def advance(self, action: Action, *, instead: Controls | None = None) -> Ending | None:
        """Advance by one step; returns the reason why the rollout ends, or None.

        Args:
            action: the action, or None: the trajectory of an earlier one goes on.
            instead: controls that are driven in place of the action's, whose trajectory is kept for later steps.

        Raises:
            UsageError: the action is not valid; the state is that before it.
        """
        now = self.now
        if isinstance(action, Controls):
            self._controls, self._trajectory = action, None
        elif isinstance(action, PlannedTrajectory):
            self._trajectory = action.in_world(now.ego, now.time_s)
        elif isinstance(action, NoPlanYet):
            self._trajectory = self.recorded or self._route_at_speed()
        elif action is not None:
            raise UsageError(
                f"an action of type {type(action).__name__}", expected="Controls, PlannedTrajectory, NoPlanYet, None"
            )
        if self._trajectory is not None:
            self._controls = self._tracker.track(now.ego, self._trajectory, now.time_s)
        if instead is not None:
            self._controls = instead
        self.recorder.add(self.world.advance(self._controls))
        return self._ending()

    def observe(
        self, images: Mapping[str, UInt8], *, privileged: bool = False, tensors: Mapping[str, Tensor] | None = None
    ) -> Observation:
        """Return the observation of the present state, with images as arrays or as tensors."""
        now, ego = self.now, self.now.ego
        cos, sin = np.cos(ego.yaw_rad), np.sin(ego.yaw_rad)
        ahead = self.route_ahead(ROUTE_STEP_M * ROUTE_POINTS, ROUTE_STEP_M) - (ego.x_m, ego.y_m)
        route = np.column_stack([ahead @ (cos, sin), ahead @ (-sin, cos)])
        local = replace(ego, x_m=0.0, y_m=0.0, yaw_rad=0.0)
        exact = self._exact_state() if privileged else None
        return Observation(now.stamp_ns, images, local, route, self._odometry(), exact, tensors or {})

    def _odometry(self) -> Float64:
        ego, first = self.now.ego, self.recorder.snapshots[0].ego
        cos, sin = np.cos(first.yaw_rad), np.sin(first.yaw_rad)
        dx, dy = ego.x_m - first.x_m, ego.y_m - first.y_m
        return np.array([cos * dx + sin * dy, cos * dy - sin * dx, ego.yaw_rad - first.yaw_rad])

    def _route_at_speed(self) -> Trajectory:
        """The route from the place beside the ego on, at its present speed."""
        now, way = self.now, self.route.way
        times = np.arange(0.0, _NO_PLAN_S + 1e-9, 0.1)
        along = way.nearest_m(np.array([now.ego.x_m, now.ego.y_m])) + now.ego.speed_mps * times
        points = np.array([way.at(min(place, way.length_m)) for place in along])
        ahead = np.array([way.at(min(place + 1.0, way.length_m)) for place in along])
        behind = np.array([way.at(min(place + 1.0, way.length_m) - 2.0) for place in along])
        yaw = np.unwrap(np.arctan2(*(ahead - behind).T[::-1]))
        yaw += 2.0 * np.pi * np.round((now.ego.yaw_rad - yaw[0]) / (2.0 * np.pi))
        return Trajectory(now.time_s + times, np.column_stack([points, yaw]))

    def _exact_state(self) -> PrivilegedState:
        now, way = self.now, self.route.way
        along = way.nearest_m(np.array([now.ego.x_m, now.ego.y_m]))
        closed = [
            halt.along_m
            for halt in self.route.halts
            if halt.along_m > along and now.signals.get(halt.signal_id, "green") != "green"
        ]
        return PrivilegedState(
            now.time_s, now.ego, now.boxes().states, way.points, way.pace_mps, min(closed, default=math.inf),
            self.recorded,
        )  # fmt: skip

    def progress_m(self) -> float:
        """Return the distance that the ego has driven along its route since the start."""
        ego = self.now.ego
        return self.route.way.nearest_m(np.array([ego.x_m, ego.y_m])) - self.route.begin_m

    def observation_spec(self, cameras: Mapping[str, CameraSpec]) -> ObservationSpec:
        """Return the specification of observations with the given cameras."""
        return ObservationSpec(cameras, self.street.vehicle, self.step_s, self.seed)

    def route_ahead(self, reach_m: float, step_m: float) -> Float64:
        """Return points (K, 2) of the route ahead of the ego, in the world."""
        ego, way = self.now.ego, self.route.way
        along = way.nearest_m(np.array([ego.x_m, ego.y_m])) + np.arange(0.0, reach_m, step_m)
        return way.points_at(np.minimum(along, way.length_m))

    def _ending(self) -> Ending | None:
        now = self.now
        if self.stops_at_collision:
            last = self.recorder.snapshots[-2:]
            near = _find_near(*last)
            if len(near) and find_collisions(state_log(last, near)):
                return "collision"
        if now.step >= self.scenario.steps:
            return "duration"
        ego = np.array([now.ego.x_m, now.ego.y_m])
        if self.route.way.nearest_m(ego) >= self.route.way.length_m - 1.0:
            return "route_end"
        if np.hypot(*(ego - np.array(self.street.middle_m))) > self.street.radius_m + _STREET_MARGIN_M:
            return "left_street"
        if self.ends_off_road and self._is_off_road():
            return "off_road"
        return None

    def _is_off_road(self) -> bool:
        box = self.now.boxes().states[0]
        corners = corners_of(box[[0, 1, 2, 4, 5]])
        return not inside_area(np.concatenate([corners, box[None, :2]]), self._rings).any()


def start_simulation(
    street: Street,
    scenario: Scenario,
    seed: int | None = None,
    *,
    stops_at_collision: bool = True,
    ends_off_road: bool = False,
    scenario_file: str | None = None,
) -> Simulation:
    """Start a rollout.

    Args:
        street: the street.
        scenario: the scenario.
        seed: seed of the rollout; None: that of the scenario.
        stops_at_collision: whether a contact of the ego ends the rollout.
        ends_off_road: whether it ends where the whole body of the ego is off the drivable area.
        scenario_file: file of the scenario, which errors name; None: it is of no file.

    Raises:
        UsageError: the scenario does not fit on the street.
    """
    try:
        started = _start(street, scenario, scenario.seed if seed is None else seed, stops_at_collision)
    except UsageError as error:
        raise UsageError(
            error.problem, file=error.file or scenario_file, place=error.place, expected=error.expected,
            remedy=error.remedy,
        ) from error  # fmt: skip
    started.ends_off_road = ends_off_road
    return started


def _start(street: Street, scenario: Scenario, chosen: int, stops_at_collision: bool) -> Simulation:
    ego, route, recording, start_s = plan_route(street, scenario.ego)
    if not isinstance(scenario.ego.start, RecordedStart):
        street = replace(street, clock_s=_clock_of_green(street, route))
    stage = Stage(street, scenario, ego, route, recording, start_s, chosen)
    agents = AllAgents(cast_agents(stage))
    start_ns = street.recordings[recording].start_ns + round(start_s * 1e9)
    world = SimulatedWorld(street.vehicle, ego, agents, start_ns, 1.0 / scenario.rate_hz, street.signals)
    recorder = StateRecorder()
    recorder.add(world.now)
    touching = find_collisions(recorder.log())
    if touching:
        raise UsageError(
            "it starts in the ego vehicle", place=f"agent {touching[0].agent!r}",
            expected="agents that do not touch the ego at the start", remedy="change its place ahead of the ego",
        )  # fmt: skip
    recorded = None
    if isinstance(scenario.ego.start, RecordedStart):
        source = street.recordings[recording]
        recorded = Trajectory(source.times_s - start_s, source.poses)
    return Simulation(street, scenario, route, chosen, world, recorder, stops_at_collision, recorded)


def _find_near(before: Snapshot, after: Snapshot) -> Int64:
    """Find the agents (K,) that come so near to the ego in a step, by circles around boxes, that they may touch."""
    first, last = before.boxes().states, after.boxes().states
    place, end = first[1:, :2] - first[0, :2], last[1:, :2] - last[0, :2]
    reach = np.hypot(*last[:, 4:6].T)
    # Between the ends of the step, relative places are linear in time.
    least = np.hypot(*place.T) - np.hypot(*(end - place).T)
    present = (first[1:, 6] > 0.0) | (last[1:, 6] > 0.0)
    comes_or_goes = first[1:, 6] != last[1:, 6]
    return np.flatnonzero(present & (comes_or_goes | ~(least > reach[0] + reach[1:])))


def _clock_of_green(street: Street, route: RoutePlan) -> float:
    """Time of the signals' clock at which the first signal ahead on the route turns green; 0: there is none."""
    ahead = [halt for halt in route.halts if halt.along_m > route.begin_m]
    signal = street.road_map.signals.get(ahead[0].signal_id) if ahead else None
    if signal is None or not signal.phases:
        return 0.0
    before = 0.0
    for state, duration in signal.phases:
        if state == "green":
            break
        before += duration
    return signal.offset_s + before
