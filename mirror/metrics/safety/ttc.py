"""Time to collision: how long until the ego and an agent touch if both keep their velocities."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.metrics.safety.state_log import StateLog


@dataclass(frozen=True)
class LeastTimeToCollision:
    """The least time to collision of a log.

    Args:
        value_s: seconds until the contact; inf where no contact lies within the horizon.
        stamp_ns: stamp of the instant at which the value is least; None where there is none.
        agent: id of the agent that would be hit; None where there is none.
        by_agent_s: (N,) least value for each actor; inf for the ego and for agents without one.
    """

    value_s: float
    stamp_ns: int | None
    agent: str | None
    by_agent_s: Float64


def time_to_collision(log: StateLog) -> Float64:
    """Compute the time to collision of the ego with each agent at each stamp, without a horizon.

    Both boxes keep the velocity (its direction too: a vehicle may drive backwards) and the heading of the stamp. The
    time is the exact root of the swept boxes (separating axes), not a multiple of a step.

    Returns:
        (T, N) seconds; 0 where the boxes touch, inf where they never will, for absent agents and for the ego.
    """
    from mirror.metrics.safety.ttc_kernels import times_to_collision

    states, halves, present = log.kernel_arrays()
    found: Float64 = times_to_collision(states, halves, present)
    return found


def least_time_to_collision(log: StateLog, *, horizon_s: float = 3.0) -> LeastTimeToCollision:
    """Find the least time to collision over the whole log, in continuous time.

    Between stamps states are linear in time (`StateLog`). The value is sampled at 5 ms or less and refined around its
    least sample and wherever a course to a collision begins or ends, so that it does not depend on the rate of the log.

    Args:
        log: states of the ego and the agents.
        horizon_s: contacts farther in the future do not count (nuPlan: 3 s).

    Raises:
        UsageError: the horizon is not positive.
    """
    from mirror.metrics.safety.ttc_kernels import least_times_to_collision

    if not horizon_s > 0.0:
        raise UsageError(f"horizon_s is {horizon_s}", expected="a positive number of seconds")
    values, instants = least_times_to_collision(log.times_s, *log.kernel_arrays(), horizon_s)
    agent = int(np.argmin(values))
    if math.isinf(values[agent]):
        return LeastTimeToCollision(math.inf, None, None, values)
    return LeastTimeToCollision(float(values[agent]), log.stamp_at(float(instants[agent])), log.ids[agent], values)
