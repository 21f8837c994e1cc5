"""The tracker follows what the vehicle can drive, and returns to it from beside it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hybridworldsim.simulator.ego.tracker import TrajectoryTracker
from hybridworldsim.simulator.ego.trajectory import Trajectory
from hybridworldsim.simulator.ego.vehicle import Controls, EgoState, VehicleParameters, advance
from mirror.errors import UsageError

CAR = VehicleParameters()
STEP = 0.1


def drive(state: EgoState, controls: list[Controls]) -> list[EgoState]:
    states = [state]
    for command in controls:
        states.append(advance(CAR, states[-1], command, STEP))
    return states


def planned(states: list[EgoState], every: int) -> Trajectory:
    chosen = states[::every]
    return Trajectory(
        STEP * every * np.arange(len(chosen)), np.array([(state.x_m, state.y_m, state.yaw_rad) for state in chosen])
    )


def follow(state: EgoState, trajectory: Trajectory, steps: int = 40) -> list[EgoState]:
    tracker, states = TrajectoryTracker(CAR, STEP), [state]
    for step in range(steps):
        states.append(advance(CAR, states[-1], tracker.track(states[-1], trajectory, STEP * step), STEP))
    return states


def distances(a: list[EgoState], b: list[EgoState]) -> np.ndarray:
    return np.array([math.hypot(p.x_m - q.x_m, p.y_m - q.y_m) for p, q in zip(a, b)])


@pytest.mark.parametrize("speed", [0.5, 3.0, 8.0, 15.0, 30.0])
@pytest.mark.parametrize("every", [1, 5])
def test_a_drivable_trajectory_is_followed(speed: float, every: int) -> None:
    sideways = min(2.0 / max(speed, 2.0) ** 2, 0.1)
    commands = [Controls(1.0 * math.cos(0.12 * step), sideways * math.sin(0.2 * step)) for step in range(40)]
    truth = drive(EgoState(100.0, -50.0, 2.0, speed), commands)
    assert distances(follow(truth[0], planned(truth, every)), truth).max() < 0.25


@pytest.mark.parametrize("speed", [5.0, 12.0, 25.0])
def test_an_offset_decays(speed: float) -> None:
    truth = drive(EgoState(0.0, 0.0, 0.0, speed), [Controls(0.0, 0.0)] * 40)
    driven = follow(EgoState(-0.4, 0.5, 0.03, speed), planned(truth, 5))
    assert distances(driven, truth)[-1] < 0.1
    assert min(state.y_m for state in driven) > -0.2


def test_a_trajectory_that_stops_is_left_standing() -> None:
    truth = drive(EgoState(0.0, 0.0, 0.5, 9.0), [Controls(-3.0, 0.0)] * 40)
    driven = follow(truth[0], planned(truth, 5), 60)
    assert driven[-1].speed_mps < 0.05
    assert math.hypot(driven[-1].x_m - truth[-1].x_m, driven[-1].y_m - truth[-1].y_m) < 0.3


def test_the_result_does_not_depend_on_the_frame() -> None:
    truth = drive(EgoState(0.0, 0.0, 0.0, 8.0), [Controls(0.5, 0.02)] * 40)
    turn, shift = 2.4, np.array([512_000.0, -37.5])
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])

    def moved(state: EgoState) -> EgoState:
        x, y = rotation @ (state.x_m, state.y_m) + shift
        return EgoState(x, y, state.yaw_rad + turn, state.speed_mps, state.acceleration_mps2, state.steering_rad)

    here = follow(truth[0], planned(truth, 5))
    there = follow(moved(truth[0]), planned([moved(state) for state in truth], 5))
    assert distances([moved(state) for state in here], there).max() < 1e-6


def test_broken_trajectories_are_refused() -> None:
    times = np.arange(3.0)
    with pytest.raises(UsageError, match="increase"):
        Trajectory(times[::-1], np.zeros((3, 3)))
    with pytest.raises(UsageError, match="shape"):
        Trajectory(times, np.zeros((2, 3)))
    with pytest.raises(UsageError, match="finite"):
        Trajectory(times, np.full((3, 3), math.nan))
