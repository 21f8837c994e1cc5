"""The kinematic bicycle against the closed form of a circle and against a fine integration of its equations."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from hybridworldsim.simulator.ego.vehicle import (
    Controls,
    EgoState,
    VehicleParameters,
    advance,
    center_position,
    center_velocity,
)
from mirror.errors import UsageError
from tests.draws import draws

CAR = VehicleParameters()
CONTROLS = st.builds(Controls, st.floats(-12.0, 6.0), st.floats(-0.4, 0.4))
STATES = st.builds(
    EgoState,
    st.floats(-1e3, 1e3),
    st.floats(-1e3, 1e3),
    st.floats(-4.0, 4.0),
    st.floats(0.0, 40.0),
    st.floats(-8.0, 4.0),
    st.floats(-0.6, 0.6),
)


def integrate(state: EgoState, controls: Controls, duration: float) -> np.ndarray:
    """x, y, yaw, speed by an adaptive Runge-Kutta method of order 8, in float64, piece by piece between the corners."""
    target = min(max(controls.acceleration_mps2, -CAR.max_deceleration_mps2), CAR.max_acceleration_mps2)
    angle = math.atan(controls.curvature_radpm * CAR.wheelbase_m)
    angle = min(max(angle, -CAR.max_steering_rad), CAR.max_steering_rad)

    def towards(value: float, goal: float, rate: float, t: float) -> float:
        return value + math.copysign(min(rate * t, abs(goal - value)), goal - value)

    begin = 0.0 if state.speed_mps == 0.0 and state.acceleration_mps2 < 0.0 else state.acceleration_mps2

    def slope(t: float, z: np.ndarray) -> list[float]:
        a = towards(begin, target, CAR.max_jerk_mps3, t)
        steering = towards(state.steering_rad, angle, CAR.max_steering_rate_radps, t)
        # A speed below zero goes on smoothly: a corner there would spoil the dense output in which the stop is found.
        v = z[3]
        return [v * math.cos(z[2]), v * math.sin(z[2]), v * math.tan(steering) / CAR.wheelbase_m, a]

    def stands(t: float, z: np.ndarray) -> float:
        slows = towards(begin, target, CAR.max_jerk_mps3, t) < 0.0
        return float(z[3]) if t > 0.0 and slows else 1.0

    stands.terminal = True
    stands.direction = -1.0
    corners = [
        abs(target - begin) / CAR.max_jerk_mps3,
        abs(angle - state.steering_rad) / CAR.max_steering_rate_radps,
    ]
    times = sorted({0.0, duration, *(t for t in corners if 0.0 < t < duration)})
    z = np.array([state.x_m, state.y_m, state.yaw_rad, state.speed_mps])
    for low, high in itertools.pairwise(times):
        solution = solve_ivp(slope, (low, high), z, method="DOP853", rtol=1e-12, atol=1e-12, events=stands)
        z = solution.y[:, -1]
        if solution.status == 1:
            stop = float(solution.t[-1])
            if target <= 0.0:
                return np.array([*z[:3], 0.0])
            steering = towards(state.steering_rad, angle, CAR.max_steering_rate_radps, stop)
            return integrate(EgoState(*z[:3], 0.0, 0.0, steering), controls, duration - stop)
    return z


def numbers(state: EgoState) -> np.ndarray:
    return np.array([state.x_m, state.y_m, state.yaw_rad, state.speed_mps])


def test_constant_controls_follow_a_circle_exactly() -> None:
    curvature = 0.08
    start = EgoState(10.0, -4.0, 0.3, 12.0, 1.5, math.atan(curvature * CAR.wheelbase_m))
    end = advance(CAR, start, Controls(1.5, curvature), 2.0)
    arc = 12.0 * 2.0 + 0.5 * 1.5 * 4.0
    yaw = 0.3 + curvature * arc
    x = 10.0 + (math.sin(yaw) - math.sin(0.3)) / curvature
    y = -4.0 - (math.cos(yaw) - math.cos(0.3)) / curvature
    assert np.allclose(numbers(end), [x, y, yaw, 15.0], rtol=0.0, atol=1e-12)


def test_a_straight_line_has_no_rounding() -> None:
    end = advance(CAR, EgoState(0.0, 0.0, 0.0, 10.0), Controls(0.0, 0.0), 3.0)
    assert (end.x_m, end.y_m, end.yaw_rad, end.speed_mps) == (30.0, 0.0, 0.0, 10.0)


@settings(max_examples=draws(150), deadline=None)
@given(STATES, CONTROLS, st.sampled_from([0.01, 0.1, 0.5]))
def test_any_controls_agree_with_a_fine_integration(state: EgoState, controls: Controls, duration: float) -> None:
    assert np.allclose(
        numbers(advance(CAR, state, controls, duration)), integrate(state, controls, duration), rtol=0.0, atol=2e-8
    )


@settings(max_examples=draws(100), deadline=None)
@given(STATES, CONTROLS)
def test_the_division_into_steps_does_not_matter(state: EgoState, controls: Controls) -> None:
    whole = advance(CAR, state, controls, 1.0)
    parts = state
    for _ in range(10):
        parts = advance(CAR, parts, controls, 0.1)
    assert np.allclose(numbers(whole), numbers(parts), rtol=0.0, atol=1e-8)


@settings(max_examples=draws(100), deadline=None)
@given(STATES, CONTROLS)
def test_limits_hold(state: EgoState, controls: Controls) -> None:
    step = 0.05
    end = advance(CAR, state, controls, step)
    tolerance = 1e-12
    assert end.speed_mps >= 0.0
    assert abs(end.steering_rad) <= CAR.max_steering_rad + tolerance
    assert abs(end.steering_rad - state.steering_rad) <= CAR.max_steering_rate_radps * step + tolerance
    assert -CAR.max_deceleration_mps2 - tolerance <= end.acceleration_mps2 <= CAR.max_acceleration_mps2 + tolerance
    # At standstill the acceleration ends at once.
    if state.speed_mps > CAR.max_deceleration_mps2 * step:
        assert abs(end.acceleration_mps2 - state.acceleration_mps2) <= CAR.max_jerk_mps3 * step + tolerance


def test_braking_ends_at_standstill_and_the_vehicle_starts_again() -> None:
    state = advance(CAR, EgoState(0.0, 0.0, 0.0, 8.0, -8.0), Controls(-8.0, 0.0), 3.0)
    assert (state.speed_mps, state.acceleration_mps2) == (0.0, 0.0)
    assert state.x_m == pytest.approx(4.0, abs=1e-12)
    assert advance(CAR, state, Controls(-8.0, 0.0), 5.0).x_m == state.x_m
    assert advance(CAR, state, Controls(2.0, 0.0), 1.0).speed_mps > 1.5


def test_the_middle_of_the_body_moves_with_its_velocity() -> None:
    state = EgoState(3.0, 1.0, 0.7, 9.0, 0.0, 0.3)
    curvature = math.tan(0.3) / CAR.wheelbase_m
    h = 1e-5
    before, after = (
        np.array(center_position(CAR, advance(CAR, start, Controls(0.0, curvature), t)))
        for start, t in ((state, 0.0), (state, h))
    )
    assert np.allclose((after - before) / h, center_velocity(CAR, state), atol=1e-3)


@pytest.mark.parametrize("wrong", [(math.nan, 0.0), (0.0, math.inf)])
def test_controls_that_are_not_finite_are_refused(wrong: tuple[float, float]) -> None:
    with pytest.raises(UsageError, match="finite"):
        Controls(*wrong)


def test_impossible_vehicles_and_durations_are_refused() -> None:
    with pytest.raises(UsageError, match="wheelbase_m"):
        VehicleParameters(wheelbase_m=0.0)
    with pytest.raises(UsageError, match="duration_s"):
        advance(CAR, EgoState(0.0, 0.0, 0.0, 0.0), Controls(0.0, 0.0), -1.0)
