"""An attack: the search of a plausible manoeuvre of an agent that brings the least time to collision with the ego.

The search knows the ego's present state only: it predicts that the ego keeps its speed on its route. A manoeuvre is a
target speed, an acceleration, a lateral shift and its duration. It is plausible if the agent's accelerations stay
within limits, it stays on the drivable area, and it does not touch an agent other than the ego.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hybridworldsim.simulator.agents.corridor import poses_on_ways
from hybridworldsim.simulator.agents.scripts import Script
from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.metrics.safety import StateLog, find_collisions, least_time_to_collision
from mirror.traffic.lanes.ways import Way

MOST_EVALUATIONS: Final = 50
_STEP_S: Final = 0.2
_GREATEST_SHIFT_M: Final = 5.0
_EXPLORED: Final = 20
_NEVER: Final = 1e3
_IMPLAUSIBLE: Final = 1e6


@dataclass(frozen=True)
class AttackPlan:
    """The beginning of an attack, and the limits of its manoeuvre.

    Attributes:
        trigger_ttc_s: time to collision at which it begins.
        latest_s: time at which it begins in any case.
        evaluations: number of manoeuvres that may be evaluated, 1 to `MOST_EVALUATIONS`.
        horizon_s: duration of a manoeuvre.
        max_acceleration_mps2: greatest longitudinal acceleration.
        max_lateral_acceleration_mps2: greatest lateral acceleration.
        seed: seed of the search.
    """

    trigger_ttc_s: float
    latest_s: float = math.inf
    evaluations: int = MOST_EVALUATIONS
    horizon_s: float = 4.0
    max_acceleration_mps2: float = 4.0
    max_lateral_acceleration_mps2: float = 4.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.evaluations <= MOST_EVALUATIONS:
            raise UsageError(f"{self.evaluations} evaluations", place="attack", expected=f"1 to {MOST_EVALUATIONS}")


@dataclass(frozen=True)
class Attacker:
    """The agent that attacks, at the beginning of its manoeuvre.

    Attributes:
        way: way that it follows.
        front_m: length of its front end along the way.
        speed_mps: its speed.
        aside_m: its offset to the left.
        length_m: its length.
        width_m: its width.
    """

    way: Way
    front_m: float
    speed_mps: float
    aside_m: float
    length_m: float
    width_m: float


@dataclass(frozen=True)
class AttackManoeuvre:
    """The manoeuvre that was found.

    Attributes:
        script: the manoeuvre; it begins at once.
        least_ttc_s: least time to collision with the predicted ego; inf: none within the horizon.
        evaluations: number of manoeuvres that were evaluated.
    """

    script: Script
    least_ttc_s: float
    evaluations: int


def search_attack(
    attacker: Attacker,
    plan: AttackPlan,
    boxes: Float64,
    own_row: int,
    *,
    ego_line: Callable[[Float64], Float64],
    is_drivable: Callable[[Float64], bool] = lambda points: True,
) -> AttackManoeuvre:
    """Search for the manoeuvre with the least time to collision.

    Up to half of the evaluations, at most 20, explore at random; the others refine the best manoeuvre with shrinking
    steps.

    Args:
        attacker: the agent.
        plan: limits and seed of the search.
        boxes: (M, 7) boxes of all actors now, as agents perceive them; the ego is the first.
        own_row: row of the attacker.
        ego_line: predicted poses (K, 3) of the middle of the ego at times (K,) from now.
        is_drivable: whether all of some points (P, 2) lie on the drivable area.
    """
    rng = np.random.default_rng(plan.seed)
    bounds = np.array(
        [
            (0.0, attacker.speed_mps + plan.max_acceleration_mps2 * plan.horizon_s),
            (0.5, max(plan.max_acceleration_mps2, 0.6)),
            (-_GREATEST_SHIFT_M, _GREATEST_SHIFT_M),
            (min(1.0, plan.horizon_s), plan.horizon_s),
        ]
    )
    times = np.linspace(0.0, plan.horizon_s, int(plan.horizon_s / _STEP_S) + 2)
    case = _Case(attacker, plan, times, ego_line(times), boxes, own_row, is_drivable)
    best, least, span = np.array([attacker.speed_mps, 1.0, 0.0, plan.horizon_s]), math.inf, 0.5
    for number in range(plan.evaluations):
        if number == 0:
            candidate = best
        elif number < min(_EXPLORED, max(plan.evaluations // 2, 1)):
            candidate = rng.uniform(bounds[:, 0], bounds[:, 1])
        else:
            step = span * rng.normal(size=len(bounds)) * (bounds[:, 1] - bounds[:, 0])
            candidate = np.clip(best + step, bounds[:, 0], bounds[:, 1])
            span *= 0.93
        cost = _cost(_script(candidate), case)
        if cost < least:
            best, least = candidate, cost
    return AttackManoeuvre(_script(best), least if least < _NEVER else math.inf, plan.evaluations)


@dataclass(frozen=True, eq=False)
class _Case:
    attacker: Attacker
    plan: AttackPlan
    times: Float64
    ego: Float64
    boxes: Float64
    own_row: int
    is_drivable: Callable[[Float64], bool]


def _script(numbers: Float64) -> Script:
    speed, acceleration, shift, duration = numbers.tolist()
    return Script(
        trigger_ttc_s=1.0, latest_s=0.0, speed_mps=speed, acceleration_mps2=acceleration, shift_m=shift,
        shift_s=duration,
    )  # fmt: skip


def _cost(script: Script, case: _Case) -> float:
    """Least time to collision; beyond `_NEVER` the least distance counts, `_IMPLAUSIBLE` is worse than all."""
    attacker, times, plan = case.attacker, case.times, case.plan
    target = script.speed_mps or 0.0
    change = np.clip(target - attacker.speed_mps, -script.acceleration_mps2 * times, script.acceleration_mps2 * times)
    speed = attacker.speed_mps + change
    front = attacker.front_m + np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(times))])
    shifts = np.array([script.shift(float(time)) for time in times])
    state = np.column_stack([front, speed, np.zeros(len(times)), attacker.aside_m + shifts[:, 0], shifts[:, 1]])
    first = np.array([0, len(attacker.way.points)])
    lengths = np.full(len(times), attacker.length_m)
    poses, velocities = poses_on_ways(attacker.way.points, first, np.zeros(len(times), np.int64), lengths, state)
    rates = np.gradient(velocities, times, axis=0)
    across = np.abs(velocities[:, 0] * rates[:, 1] - velocities[:, 1] * rates[:, 0]) / np.maximum(speed, 1.0)
    if across.max() > plan.max_lateral_acceleration_mps2 or not case.is_drivable(poses[:, :2]):
        return _IMPLAUSIBLE
    others = [row for row in range(1, len(case.boxes)) if row != case.own_row and case.boxes[row, 6] > 0.0]
    if others and _touches(times, poses, attacker, case.boxes[others]):
        return _IMPLAUSIBLE
    own = np.array([attacker.length_m, attacker.width_m]) / 2.0
    log = _log(times, [(case.ego, case.boxes[0, 4:6]), (poses, own)])
    found = least_time_to_collision(log, horizon_s=plan.horizon_s)
    if math.isfinite(found.value_s):
        return found.value_s
    return _NEVER + float(np.linalg.norm(case.ego[:, :2] - poses[:, :2], axis=1).min())


def _touches(times: Float64, poses: Float64, attacker: Attacker, others: Float64) -> bool:
    """Return whether the manoeuvre touches an agent that keeps its velocity."""
    actors = [(poses, np.array([attacker.length_m, attacker.width_m]) / 2.0)]
    for x, y, yaw, speed, half_length, half_width, _ in others:
        line = np.column_stack(
            [x + speed * math.cos(yaw) * times, y + speed * math.sin(yaw) * times, np.full(len(times), yaw)]
        )
        actors.append((line, np.array([half_length, half_width])))
    log = _log(times, actors)
    # What already touches at the beginning was not caused by the manoeuvre.
    return any(collision.stamp_ns > int(log.stamps_ns[0]) for collision in find_collisions(log))


def _log(times: Float64, actors: Sequence[tuple[Float64, Float64]]) -> StateLog:
    poses = np.stack([line for line, _ in actors], axis=1)
    velocity = np.gradient(poses[..., :2], times, axis=0)
    halves = np.array([half for _, half in actors])
    count = len(actors)
    return StateLog(
        np.round(times * 1e9).astype(np.int64), poses[..., 0].copy(), poses[..., 1].copy(), poses[..., 2].copy(),
        velocity[..., 0].copy(), velocity[..., 1].copy(), 2.0 * halves[:, 0], 2.0 * halves[:, 1],
        np.ones((len(times), count), np.bool_), tuple(f"actor-{number}" for number in range(count)),
        ("vehicle",) * count, 0.0,
    )  # fmt: skip
