"""Tracks a trajectory with the ego vehicle: linear-quadratic regulators of the longitudinal and the lateral error.

The errors are those in the frame of the reference point. The lateral regulator has the steering curvature as a state,
so that its change is penalised and the delay of the steering is part of the model (Anderson, Moore, "Optimal Control:
Linear Quadratic Methods", chapter 9).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np

from hybridworldsim.simulator.ego.trajectory import Trajectory
from hybridworldsim.simulator.ego.vehicle import Controls, EgoState, VehicleParameters, curvature_of
from mirror.arrays import Float64

_LONGITUDINAL_COSTS: Final = (1.0, 1.0, 0.3)
"""Costs of the station error, the speed error and the acceleration beyond the reference's."""
_LATERAL_COSTS: Final = (1.0, 6.0, 4.0, 40.0)
"""Costs of the lateral error, the heading error, the curvature beyond the reference's, and its change."""
_SLOWEST_MPS: Final = 1.0
_SPEED_STEP_MPS: Final = 0.5
_LONGEST_CORRECTION_M: Final = 2.0


class TrajectoryTracker:
    """A controller that turns a trajectory into controls.

    Args:
        vehicle: the vehicle.
        step_s: time for which controls are constant.
    """

    def __init__(self, vehicle: VehicleParameters, step_s: float) -> None:
        self.vehicle, self.step_s = vehicle, step_s

    def track(self, state: EgoState, trajectory: Trajectory, time_s: float) -> Controls:
        """Return the controls of the step that begins at a time.

        Args:
            state: state of the vehicle at that time.
            trajectory: the trajectory, in the same frame and times.
            time_s: the time.
        """
        now = trajectory.at(time_s)
        soon = trajectory.at(time_s + self.step_s)
        cos, sin = math.cos(now.yaw_rad), math.sin(now.yaw_rad)
        dx, dy = state.x_m - now.x_m, state.y_m - now.y_m
        along = min(max(cos * dx + sin * dy, -_LONGEST_CORRECTION_M), _LONGEST_CORRECTION_M)
        aside = min(max(-sin * dx + cos * dy, -_LONGEST_CORRECTION_M), _LONGEST_CORRECTION_M)
        turned = math.remainder(state.yaw_rad - now.yaw_rad, 2.0 * math.pi)
        longitudinal = _longitudinal_gain(self.step_s) @ (along, state.speed_mps - now.speed_mps)
        reference = (soon.speed_mps - now.speed_mps) / self.step_s
        bend = soon.curvature_radpm
        own = curvature_of(self.vehicle, state)
        speed = max(_SPEED_STEP_MPS * round(state.speed_mps / _SPEED_STEP_MPS), _SLOWEST_MPS)
        change = -_lateral_gain(self.step_s, speed) @ (aside, turned, own - bend)
        return Controls(float(reference - longitudinal), float(own + change))


@lru_cache(maxsize=8)
def _longitudinal_gain(step_s: float) -> Float64:
    station, speed, effort = _LONGITUDINAL_COSTS
    motion = np.array([[1.0, step_s], [0.0, 1.0]])
    entry = np.array([[0.5 * step_s * step_s], [step_s]])
    return _gain(motion, entry, np.diag([station, speed]), np.array([[effort]]))


@lru_cache(maxsize=256)
def _lateral_gain(step_s: float, speed_mps: float) -> Float64:
    aside, heading, curvature, change = _LATERAL_COSTS
    length = speed_mps * step_s
    motion = np.array([[1.0, length, 0.5 * length * length], [0.0, 1.0, length], [0.0, 0.0, 1.0]])
    entry = np.array([[0.5 * length * length], [length], [1.0]])
    # Curvature counts as lateral acceleration, so that fast vehicles steer gently.
    square = max(speed_mps, 3.0) ** 4 * 1e-2
    return _gain(motion, entry, np.diag([aside, heading, curvature * square]), np.array([[change * square]]))


def _gain(motion: Float64, entry: Float64, state_costs: Float64, control_costs: Float64) -> Float64:
    """The gain (S,) of the infinite-horizon regulator of one control, from the discrete Riccati equation."""
    from scipy.linalg import solve_discrete_are

    costs = solve_discrete_are(motion, entry, state_costs, control_costs)
    gain: Float64 = np.linalg.solve(control_costs + entry.T @ costs @ entry, entry.T @ costs @ motion)[0]
    return gain
