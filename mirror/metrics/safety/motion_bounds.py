"""Bounds on consecutive states of a log: nothing jumps, and the ego moves like a vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.metrics.safety.state_log import StateLog

_FASTEST_MPS: Final = {"pedestrian": 13.0, "cyclist": 30.0, "bicycle": 30.0}
_VEHICLE_MPS: Final = 80.0
_ACCELERATION_MPS2: Final = 13.0
"""No road vehicle accelerates or brakes harder on dry asphalt."""
_CURVATURE_RADPM: Final = 0.35
"""The rear axle of no car turns on a circle with a radius below 2.9 m."""
_SLIP: Final = 0.15
"""Greatest ratio of a step's sideways and forward part, in the mean heading of its ends."""

_NO_ARC: Final = 0.1
_AGENT_SLACK_M: Final = 1.0
_EGO_SLACK_M: Final = 0.1
_SPEED_SLACK_MPS: Final = 0.5
_YAW_SLACK_RAD: Final = 0.03


@dataclass(frozen=True)
class ImpossibleMotion:
    """The first step of a log that no body can make.

    Attributes:
        actor: id of the actor.
        stamp_ns: stamp at the end of the step.
        problem: the quantity beyond its bound, with both.
    """

    actor: str
    stamp_ns: int
    problem: str


def find_impossible_motion(log: StateLog) -> ImpossibleMotion | None:
    """Find the first step of a log that no body can make; None if all steps are possible.

    All actors: the speed is at most that of the category (pedestrians 13 m/s, bicycles 30 m/s, others 80 m/s). Agents:
    the place after a step is the one to which the mean velocity leads, within 1 m (the noise of labels) and what an
    acceleration of 13 m/s2 changes. The ego: the speed of its rear axle changes by at most 13 m/s2, the distance
    follows from the speed to 0.1 m, the path has at most a curvature of 0.35 / m, and leads ahead. Actors that are
    absent at one end of a step are not compared over it.

    Args:
        log: the log.
    """
    if len(log.stamps_ns) == 0:
        return None
    steps_s = 1e-9 * np.diff(log.stamps_ns)
    for problem in (_speeds(log), _jumps(log, steps_s), *_ego_steps(log, steps_s)):
        if problem is not None:
            return problem
    return None


def _speeds(log: StateLog) -> ImpossibleMotion | None:
    fastest = np.array([_FASTEST_MPS.get(category, _VEHICLE_MPS) for category in log.categories])
    speeds = np.hypot(log.vx_mps, log.vy_mps)
    return _first(log, log.present & (speeds > fastest), speeds, fastest, "speed", "m/s")


def _jumps(log: StateLog, steps_s: Float64) -> ImpossibleMotion | None:
    step = steps_s[:, None]
    off = [
        np.diff(place, axis=0) - 0.5 * step * (rate[1:] + rate[:-1])
        for place, rate in ((log.x_m, log.vx_mps), (log.y_m, log.vy_mps))
    ]
    distance = np.hypot(*off)
    allowed = np.broadcast_to(_AGENT_SLACK_M + 0.25 * _ACCELERATION_MPS2 * step**2, distance.shape)
    # The ego, whose velocity may turn far in a step, has its own test.
    both = log.present[1:] & log.present[:-1] & (np.arange(len(log.ids)) > 0)
    return _first(log, both & (distance > allowed), distance, allowed, "distance from where its velocity leads", "m", 1)


def _ego_steps(log: StateLog, steps_s: Float64) -> list[ImpossibleMotion | None]:
    cos, sin = np.cos(log.yaw_rad[:, 0]), np.sin(log.yaw_rad[:, 0])
    x = log.x_m[:, 0] - log.rear_axle_to_center_m * cos
    y = log.y_m[:, 0] - log.rear_axle_to_center_m * sin
    speed = log.vx_mps[:, 0] * cos + log.vy_mps[:, 0] * sin
    turn = np.diff(log.yaw_rad[:, 0])
    turn -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
    middle = log.yaw_rad[:-1, 0] + 0.5 * turn
    dx, dy = np.diff(x), np.diff(y)
    ahead, aside = dx * np.cos(middle) + dy * np.sin(middle), dy * np.cos(middle) - dx * np.sin(middle)
    # The arc over a chord.
    path = ahead / np.sinc(np.clip(0.5 * turn, -1.5, 1.5) / np.pi)
    change = np.abs(np.diff(speed))
    greatest = _ACCELERATION_MPS2 * steps_s + _SPEED_SLACK_MPS
    off = np.abs(path - 0.5 * steps_s * (speed[1:] + speed[:-1]))
    # Where the curvature changes within a step, the path is no arc: the difference grows with the square of the turn.
    no_arc = _NO_ARC * turn**2 * np.abs(speed[1:] + speed[:-1]) * steps_s
    nearest = 0.25 * _ACCELERATION_MPS2 * steps_s**2 + _EGO_SLACK_M + no_arc
    bend = _CURVATURE_RADPM * np.abs(path) + _YAW_SLACK_RAD
    slip = _SLIP * np.abs(ahead) + _EGO_SLACK_M + no_arc
    return [
        _first(log, (values > most)[:, None], values[:, None], most[:, None], name, unit, 1)
        for values, most, name, unit in (
            (change, greatest, "change of speed in a step", "m/s"),
            (off, nearest, "distance from where its speed leads", "m"),
            (np.abs(turn), bend, "turn in a step", "rad"),
            (np.abs(aside), slip, "way sideways in a step", "m"),
        )
    ]


def _first(
    log: StateLog, wrong: Bool, values: Float64, bounds: Float64, name: str, unit: str, later: int = 0
) -> ImpossibleMotion | None:
    """The first wrong one of values (T, N), whose row 0 ends at stamp ``later``."""
    if not wrong.any():
        return None
    row, actor = np.argwhere(wrong)[0]
    bound = np.broadcast_to(bounds, values.shape)[row, actor]
    problem = f"{name}: {values[row, actor]:.2f} {unit}, at most {bound:.2f} {unit} is possible"
    return ImpossibleMotion(log.ids[actor], int(log.stamps_ns[row + later]), problem)
