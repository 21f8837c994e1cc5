"""The motion of the ego vehicle: a kinematic bicycle with limits of steering, its rate, acceleration and jerk.

The state is that of the middle of the rear axle, which moves along the vehicle's heading. A command gives a target
acceleration and a target curvature. The acceleration changes towards its target at the greatest jerk, the steering
angle at its greatest rate. The motion between these events has a closed form while the steering angle is constant: an
arc of a circle, whatever the speed does. While it changes, Gauss-Legendre collocation integrates the heading and the
position (Hairer, Lubich, Wanner, "Geometric Numerical Integration", section II.1.3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError

_STAGES: Final = 6
_LONGEST_RAMP_S: Final = 0.1
_STRAIGHT_RAD: Final = 1e-4


@dataclass(frozen=True)
class VehicleParameters:
    """Dimensions and limits of a vehicle; the defaults are a saloon's.

    Attributes:
        length_m: length of the body.
        width_m: width of the body.
        height_m: height of the body.
        wheelbase_m: distance between the axles.
        rear_axle_to_center_m: distance from the rear axle forward to the middle of the body.
        max_steering_rad: greatest angle of the front wheels.
        max_steering_rate_radps: greatest rate of that angle.
        max_acceleration_mps2: greatest acceleration.
        max_deceleration_mps2: greatest deceleration.
        max_jerk_mps3: greatest rate of the acceleration.
    """

    length_m: float = 4.7
    width_m: float = 1.85
    height_m: float = 1.5
    wheelbase_m: float = 2.8
    rear_axle_to_center_m: float = 1.4
    max_steering_rad: float = 0.6
    max_steering_rate_radps: float = 0.6
    max_acceleration_mps2: float = 4.0
    max_deceleration_mps2: float = 8.0
    max_jerk_mps3: float = 40.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value > 0.0):
                raise UsageError(f"{name} is {value}", place="vehicle", expected="a positive, finite number")
        if self.max_steering_rad >= 0.5 * math.pi:
            raise UsageError(f"max_steering_rad is {self.max_steering_rad}", place="vehicle", expected="below pi / 2")

    @property
    def max_curvature_radpm(self) -> float:
        """Greatest curvature of the path of the rear axle."""
        return math.tan(self.max_steering_rad) / self.wheelbase_m


@dataclass(frozen=True)
class EgoState:
    """State of the ego vehicle, at the middle of its rear axle.

    Attributes:
        x_m: position in the world.
        y_m: position in the world.
        yaw_rad: heading, counter-clockwise from x; not wrapped.
        speed_mps: forward speed, 0 or more.
        acceleration_mps2: forward acceleration.
        steering_rad: angle of the front wheels, positive to the left.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    acceleration_mps2: float = 0.0
    steering_rad: float = 0.0


@dataclass(frozen=True)
class Controls:
    """Target controls of one step.

    Attributes:
        acceleration_mps2: target acceleration; negative: braking. The vehicle stops at standstill.
        curvature_radpm: target curvature of the path of the rear axle, positive to the left.
    """

    acceleration_mps2: float
    curvature_radpm: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not math.isfinite(value):
                raise UsageError(f"{name} is {value}", place="controls", expected="a finite number")


def curvature_of(vehicle: VehicleParameters, state: EgoState) -> float:
    """Return the curvature of the path of the rear axle, 1/m."""
    return math.tan(state.steering_rad) / vehicle.wheelbase_m


def center_velocity(vehicle: VehicleParameters, state: EgoState) -> tuple[float, float]:
    """Return the velocity of the middle of the body in the world, m/s."""
    sideways = vehicle.rear_axle_to_center_m * state.speed_mps * curvature_of(vehicle, state)
    cos, sin = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
    return state.speed_mps * cos - sideways * sin, state.speed_mps * sin + sideways * cos


def center_position(vehicle: VehicleParameters, state: EgoState) -> tuple[float, float]:
    """Return the middle of the body in the world, metres."""
    reach = vehicle.rear_axle_to_center_m
    return state.x_m + reach * math.cos(state.yaw_rad), state.y_m + reach * math.sin(state.yaw_rad)


def advance(vehicle: VehicleParameters, state: EgoState, controls: Controls, duration_s: float) -> EgoState:
    """Return the state after a time under constant target controls.

    Targets beyond the limits of the vehicle are clipped. The result does not depend on how the time is divided into
    steps, except for rounding.

    Raises:
        UsageError: the duration is negative or not finite.
    """
    if not (math.isfinite(duration_s) and duration_s >= 0.0):
        raise UsageError(f"duration_s is {duration_s}", expected="a finite number of seconds, 0 or more")
    target_acceleration = min(
        max(controls.acceleration_mps2, -vehicle.max_deceleration_mps2), vehicle.max_acceleration_mps2
    )
    steering = math.atan(controls.curvature_radpm * vehicle.wheelbase_m)
    target_steering = min(max(steering, -vehicle.max_steering_rad), vehicle.max_steering_rad)
    rest = duration_s
    while rest > 0.0:
        if state.speed_mps <= 0.0 and state.acceleration_mps2 < 0.0:
            state = replace(state, acceleration_mps2=0.0)
        stands = state.speed_mps <= 0.0 and state.acceleration_mps2 <= 0.0 and target_acceleration <= 0.0
        jerk, jerk_end = (0.0, math.inf)
        if not stands:
            jerk, jerk_end = _ramp(state.acceleration_mps2, target_acceleration, vehicle.max_jerk_mps3)
        rate, rate_end = _ramp(state.steering_rad, target_steering, vehicle.max_steering_rate_radps)
        stop = math.inf if stands else _standstill(state.speed_mps, state.acceleration_mps2, jerk)
        span = min(rest, jerk_end, rate_end, stop, _LONGEST_RAMP_S if rate else math.inf)
        state = _move(vehicle, state, jerk, rate, span)
        if span == stop:
            state = replace(state, speed_mps=0.0, acceleration_mps2=0.0)
        if span == jerk_end:
            state = replace(state, acceleration_mps2=target_acceleration)
        if span == rate_end:
            state = replace(state, steering_rad=target_steering)
        rest -= span
    return state


def coast(vehicle: VehicleParameters, state: EgoState, offset_s: float) -> EgoState:
    """Return the state a little later, or earlier, at the present acceleration and steering angle.

    A vehicle that comes to a standstill, or that has just left one, stands still beyond it.
    """
    span, speed, acceleration = offset_s, state.speed_mps, state.acceleration_mps2
    if speed + acceleration * span < 0.0:
        span = -speed / acceleration
    return _move(vehicle, state, 0.0, 0.0, span)


def _ramp(value: float, target: float, greatest: float) -> tuple[float, float]:
    """Rate at which a value changes towards a target, and the time at which it arrives; (0, inf) if it is there."""
    if value == target:
        return 0.0, math.inf
    return math.copysign(greatest, target - value), abs(target - value) / greatest


def _standstill(speed: float, acceleration: float, jerk: float) -> float:
    """First time above 0 at which ``speed + acceleration t + jerk t^2 / 2`` falls to 0; inf: never."""
    if jerk == 0.0:
        return -speed / acceleration if acceleration < 0.0 else math.inf
    square = acceleration * acceleration - 2.0 * jerk * speed
    if square < 0.0:
        return math.inf
    root = math.sqrt(square)
    # Two forms of the roots, so that no difference of nearly equal numbers is divided.
    q = -(acceleration + math.copysign(root, acceleration))
    candidates = [q / jerk] + ([2.0 * speed / q] if q != 0.0 else [])
    falling = [t for t in candidates if t > 0.0 and acceleration + jerk * t <= 0.0]
    return min(falling, default=math.inf)


def _move(vehicle: VehicleParameters, state: EgoState, jerk: float, rate: float, span: float) -> EgoState:
    v, a = state.speed_mps, state.acceleration_mps2
    length = span * (v + span * (a / 2.0 + span * jerk / 6.0))
    if rate == 0.0:
        turn = length * curvature_of(vehicle, state)
        chord = length * _sinc(0.5 * turn)
        x = state.x_m + chord * math.cos(state.yaw_rad + 0.5 * turn)
        y = state.y_m + chord * math.sin(state.yaw_rad + 0.5 * turn)
    else:
        times = span * _NODES
        speeds = v + times * (a + 0.5 * jerk * times)
        turns = span * speeds * np.tan(state.steering_rad + rate * times) / vehicle.wheelbase_m
        yaws = state.yaw_rad + _INNER @ turns
        turn = float(_WEIGHTS @ turns)
        x = state.x_m + span * float(_WEIGHTS @ (speeds * np.cos(yaws)))
        y = state.y_m + span * float(_WEIGHTS @ (speeds * np.sin(yaws)))
    return EgoState(
        x,
        y,
        state.yaw_rad + turn,
        max(v + span * (a + 0.5 * jerk * span), 0.0),
        a + jerk * span,
        state.steering_rad + rate * span,
    )


def _sinc(angle: float) -> float:
    return math.sin(angle) / angle if abs(angle) > _STRAIGHT_RAD else 1.0 - angle * angle / 6.0


def _collocation(stages: int) -> tuple[Float64, Float64, Float64]:
    """Nodes (S,), weights (S,) and inner weights (S, S) of Gauss-Legendre collocation on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(stages)
    nodes, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    inner = np.empty((stages, stages))
    for column in range(stages):
        others = np.delete(nodes, column)
        basis = np.poly1d(np.poly(others)) / np.prod(nodes[column] - others)
        inner[:, column] = np.polyint(basis)(nodes)
    return nodes, weights, inner


_NODES, _WEIGHTS, _INNER = _collocation(_STAGES)
