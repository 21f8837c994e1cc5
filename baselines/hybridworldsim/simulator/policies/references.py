"""Reference policies. None of them reads an image, so that they drive the same in every renderer."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hybridworldsim.simulator.ego.tracker import TrajectoryTracker
from hybridworldsim.simulator.ego.vehicle import Controls, curvature_of
from hybridworldsim.simulator.policies.protocol import Action, Observation, ObservationSpec, PrivilegedState
from mirror.errors import UsageError
from mirror.traffic.lanes.ways import STEP_M

_HEADWAY_S: Final = 1.5
_STANDSTILL_M: Final = 2.0
_ACCELERATION_MPS2: Final = 1.8
_COMFORTABLE_MPS2: Final = 2.5
_SIGHT_M: Final = 100.0
_MARGIN_M: Final = 0.3
_LEAST_LOOKAHEAD_M: Final = 3.0
_LOOKAHEAD_S: Final = 0.7


class _Reference:
    cameras: tuple[str, ...] = ()
    privileged = True

    def reset(self, spec: ObservationSpec) -> None:
        """Keep the specification."""
        self.spec = spec

    def close(self) -> None:
        """Release nothing."""


class ConstantVelocity(_Reference):
    """A policy that keeps speed and curvature."""

    privileged = False

    def act(self, observation: Observation) -> Action:
        """Return controls with zero acceleration and the present curvature."""
        return Controls(0.0, curvature_of(self.spec.vehicle, observation.ego))


class Stop(_Reference):
    """A policy that brakes to a stop on a straight line."""

    privileged = False
    deceleration_mps2: Final = 4.0

    def act(self, observation: Observation) -> Action:
        """Return the controls that brake on a straight line."""
        return Controls(-self.deceleration_mps2, 0.0)


class Log(_Reference):
    """A policy that follows the recorded trajectory."""

    def act(self, observation: Observation) -> Action:
        """Return the controls that track the recording."""
        state = _state(observation)
        if state.recorded is None:
            raise UsageError(
                "there is no recorded trajectory to follow", place="--policy log",
                expected='a scenario with ego.start.kind = "recorded"',
            )  # fmt: skip
        return TrajectoryTracker(self.spec.vehicle, self.spec.step_s).track(state.ego, state.recorded, state.time_s)


class LaneKeeping(_Reference):
    """A policy that keeps to the middle of its route and its distance to the road user ahead (IDM).

    It steers to a point ahead on the route (Coulter, "Implementation of the pure pursuit path tracking algorithm",
    1992), and stops at closed stop lines.
    """

    def act(self, observation: Observation) -> Controls:
        """Return the controls."""
        state, vehicle = _state(observation), self.spec.vehicle
        ego, route = state.ego, state.route_m
        front = vehicle.rear_axle_to_center_m + 0.5 * vehicle.length_m
        nearest = int(np.argmin(((route - (ego.x_m, ego.y_m)) ** 2).sum(axis=1)))
        reach = nearest + int(max(_LOOKAHEAD_S * ego.speed_mps, _LEAST_LOOKAHEAD_M) / STEP_M)
        dx, dy = route[min(reach, len(route) - 1)] - (ego.x_m, ego.y_m)
        cos, sin = math.cos(ego.yaw_rad), math.sin(ego.yaw_rad)
        ahead, aside = cos * dx + sin * dy, -sin * dx + cos * dy
        curvature = 2.0 * aside / max(ahead * ahead + aside * aside, 1.0)
        limit = float(state.route_pace_mps[nearest : nearest + max(int(ego.speed_mps / STEP_M), 1)].min())
        free = _ACCELERATION_MPS2 * (1.0 - (ego.speed_mps / max(limit, 0.1)) ** 4)
        gap, speed = _leader(state, nearest, front, 0.5 * vehicle.width_m)
        stop = state.stop_m - STEP_M * nearest - front + _STANDSTILL_M
        wish = min(max(free, -_COMFORTABLE_MPS2), _following(ego.speed_mps, gap, speed))
        if stop > 0.0:
            wish = min(wish, _following(ego.speed_mps, stop, 0.0))
        return Controls(wish, curvature)


def _leader(state: PrivilegedState, nearest: int, front_m: float, half_width_m: float) -> tuple[float, float]:
    from hybridworldsim.simulator.agents.corridor import gap_on_way

    best = math.inf, 0.0
    for box in state.boxes[1:]:
        if box[6]:
            at = STEP_M * nearest + front_m
            found = gap_on_way(
                state.route_m, 0, len(state.route_m) - 1, at, front_m, 0.0, half_width_m + _MARGIN_M, _SIGHT_M, box
            )
            best = min(best, found)
    return best


def _following(speed_mps: float, gap_m: float, leader_mps: float) -> float:
    if math.isinf(gap_m):
        return math.inf
    ease = 2.0 * math.sqrt(_ACCELERATION_MPS2 * _COMFORTABLE_MPS2)
    desired = _STANDSTILL_M + max(speed_mps * _HEADWAY_S + speed_mps * (speed_mps - leader_mps) / ease, 0.0)
    return _ACCELERATION_MPS2 * (1.0 - (desired / max(gap_m, 0.1)) ** 2)


def _state(observation: Observation) -> PrivilegedState:
    if observation.privileged is None:
        raise UsageError("the policy needs the exact state", expected="an observation with `privileged`")
    return observation.privileged
