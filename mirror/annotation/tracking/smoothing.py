"""The path of one object from all its boxes: extended Kalman filters, smoothed backwards (H. Rauch et al., 1965).

States are ``x y vx vy`` (constant velocity) or ``x y heading speed turn-rate`` (constant turn rate and velocity; R.
Schubert et al., Comparison and evaluation of advanced motion models for vehicle tracking, FUSION 2008).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64

_TURN_RATE: Final = 0.35
_TURN_NOISE: Final = 0.3
_STRAIGHT: Final = 1e-4


@dataclass(frozen=True, eq=False)
class SmoothedPath:
    """A smoothed path at F times.

    Attributes:
        position_m: (F, 2).
        velocity_mps: (F, 2).
        sigma_m: (F,) standard deviation of the position along one axis, mean of both.
    """

    position_m: Float64
    velocity_mps: Float64
    sigma_m: Float64


def smooth_velocity(
    time_s: Float64, measured: Float64, sigma_m: Float64, acceleration: float, speed_mps: float
) -> SmoothedPath:
    """Smooth measured positions with the model of constant velocity.

    Args:
        time_s: (F,) ascending.
        measured: (F, 2) positions; NaN where there is none.
        sigma_m: (F,) their standard deviations.
        acceleration: square root of the spectral density of the acceleration, m/s2 per root hertz.
        speed_mps: standard deviation of the speed at the beginning.
    """
    first = int(np.flatnonzero(np.isfinite(measured[:, 0]))[0])
    state = np.array([*measured[first], 0.0, 0.0])
    covariance = np.diag([sigma_m[first] ** 2] * 2 + [speed_mps**2] * 2)
    means, covariances, priors, prior_covariances, steps = [], [], [], [], []
    for row, time in enumerate(time_s):
        dt = float(time - time_s[row - 1]) if row else 0.0
        step = np.eye(4)
        step[0, 2] = step[1, 3] = dt
        state = step @ state
        noise = np.kron(np.array([[dt**3 / 3.0, 0.5 * dt**2], [0.5 * dt**2, dt]]), np.eye(2))
        covariance = step @ covariance @ step.T + acceleration**2 * noise
        priors.append(state)
        prior_covariances.append(covariance)
        steps.append(step)
        if np.isfinite(measured[row, 0]):
            state, covariance = _update(state, covariance, measured[row], float(sigma_m[row]))
        means.append(state)
        covariances.append(covariance)
    smoothed, spread = _backwards(means, covariances, priors, prior_covariances, steps)
    return SmoothedPath(smoothed[:, :2], smoothed[:, 2:], spread)


def smooth_turning(
    time_s: Float64, measured: Float64, sigma_m: Float64, acceleration: float, start: SmoothedPath
) -> SmoothedPath:
    """Smooth measured positions with the model of constant turn rate and velocity.

    Args:
        time_s: (F,) ascending.
        measured: (F, 2) positions; NaN where there is none.
        sigma_m: (F,) their standard deviations.
        acceleration: square root of the spectral density of the acceleration, m/s2 per root hertz.
        start: a first solution, from `smooth_velocity`, which gives the heading and the speed at the beginning.
    """
    speed = np.linalg.norm(start.velocity_mps, axis=1)
    vx, vy = start.velocity_mps[0] if speed[0] > 0.5 else start.velocity_mps[int(np.argmax(speed))]
    state = np.array([*start.position_m[0], np.arctan2(vy, vx), speed[0], 0.0])
    covariance = np.diag([start.sigma_m[0] ** 2 + sigma_m[0] ** 2] * 2 + [0.3**2, 2.0**2, _TURN_RATE**2])
    means, covariances, priors, prior_covariances, steps = [], [], [], [], []
    for row, time in enumerate(time_s):
        dt = float(time - time_s[row - 1]) if row else 0.0
        state, step = _turn(state, dt)
        noise = np.zeros((5, 2))
        noise[:4, 0] = 0.5 * dt * np.cos(state[2]), 0.5 * dt * np.sin(state[2]), 0.0, 1.0
        noise[2, 1], noise[4, 1] = 0.5 * dt, 1.0
        noise *= np.sqrt(dt) * np.array([acceleration, _TURN_NOISE])
        covariance = step @ covariance @ step.T + noise @ noise.T + 1e-9 * np.eye(5)
        priors.append(state)
        prior_covariances.append(covariance)
        steps.append(step)
        if np.isfinite(measured[row, 0]):
            state, covariance = _update(state, covariance, measured[row], float(sigma_m[row]))
        means.append(state)
        covariances.append(covariance)
    smoothed, spread = _backwards(means, covariances, priors, prior_covariances, steps)
    heading = np.stack((np.cos(smoothed[:, 2]), np.sin(smoothed[:, 2])), axis=1)
    return SmoothedPath(smoothed[:, :2], smoothed[:, 3:4] * heading, spread)


def _turn(state: Float64, dt: float) -> tuple[Float64, Float64]:
    """The state after a time, and its derivative (5, 5) by the state before."""
    x, y, heading, speed, rate = state
    after = heading + rate * dt
    step = np.eye(5)
    step[2, 4] = dt
    if abs(rate) < _STRAIGHT:
        middle = heading + 0.5 * rate * dt
        sine, cosine = np.sin(middle), np.cos(middle)
        moved = np.array([x + speed * dt * cosine, y + speed * dt * sine, after, speed, rate])
        step[0, 2:] = -speed * dt * sine, dt * cosine, -0.5 * speed * dt * dt * sine
        step[1, 2:] = speed * dt * cosine, dt * sine, 0.5 * speed * dt * dt * cosine
        return moved, step
    sine, cosine = np.sin(after) - np.sin(heading), np.cos(heading) - np.cos(after)
    moved = np.array([x + speed / rate * sine, y + speed / rate * cosine, after, speed, rate])
    step[0, 2:] = -speed / rate * cosine, sine / rate, speed / rate * (dt * np.cos(after) - sine / rate)
    step[1, 2:] = speed / rate * sine, cosine / rate, speed / rate * (dt * np.sin(after) - cosine / rate)
    return moved, step


def _update(state: Float64, covariance: Float64, measured: Float64, sigma: float) -> tuple[Float64, Float64]:
    gain = covariance[:, :2] @ np.linalg.inv(covariance[:2, :2] + sigma**2 * np.eye(2))
    keep = np.eye(len(state))
    keep[:, :2] -= gain
    # Joseph's form stays symmetric and positive.
    return state + gain @ (measured - state[:2]), keep @ covariance @ keep.T + sigma**2 * gain @ gain.T


def _backwards(
    means: list[Float64],
    covariances: list[Float64],
    priors: list[Float64],
    prior_covariances: list[Float64],
    steps: list[Float64],
) -> tuple[Float64, Float64]:
    """Smoothed means (F, S), and standard deviations (F,) of the positions."""
    state, covariance = means[-1], covariances[-1]
    smoothed, spread = [state], [covariance]
    for row in range(len(means) - 2, -1, -1):
        gain = np.linalg.solve(prior_covariances[row + 1], steps[row + 1] @ covariances[row]).T
        state = means[row] + gain @ (state - priors[row + 1])
        covariance = covariances[row] + gain @ (covariance - prior_covariances[row + 1]) @ gain.T
        smoothed.append(state)
        spread.append(covariance)
    sigma = np.sqrt(np.maximum(np.array([0.5 * (p[0, 0] + p[1, 1]) for p in spread[::-1]]), 0.0))
    return np.array(smoothed[::-1]), sigma
