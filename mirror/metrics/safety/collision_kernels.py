"""Compiled sweep of rectangles over the steps of a log: the first contact of the ego with each agent."""

from __future__ import annotations

import math

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.compiled import compiled_above, inner_njit
from mirror.metrics.safety.rectangle_kernels import PLAIN_ELEMENTS, signed_gap

# A contact that lasts less than this may be missed; the time of any other is found to a nanosecond.
_SHORTEST_CONTACT_S = 1e-4
_BISECTIONS = 40


@inner_njit
def _gap_at(share: float, ego: Float64, agent: Float64, halves: Float64, row: int, other: int) -> float:
    """Signed gap at a share of the step from ``row`` to the next."""
    rest = 1.0 - share
    dx = rest * (agent[row, 0] - ego[row, 0]) + share * (agent[row + 1, 0] - ego[row + 1, 0])
    dy = rest * (agent[row, 1] - ego[row, 1]) + share * (agent[row + 1, 1] - ego[row + 1, 1])
    yaw_a = rest * ego[row, 2] + share * ego[row + 1, 2]
    yaw_b = rest * agent[row, 2] + share * agent[row + 1, 2]
    return float(signed_gap(dx, dy, yaw_a, yaw_b, halves[0, 0], halves[0, 1], halves[other, 0], halves[other, 1]))


@inner_njit
def _contact_in_step(ego: Float64, agent: Float64, halves: Float64, row: int, other: int, duration: float) -> float:
    """Share of a step at which two rectangles first touch; inf: they do not.

    Conservative advancement: no point of either moves faster than ``bound``, so nothing happens while the gap lasts.
    """
    vx = (agent[row + 1, 0] - agent[row, 0]) - (ego[row + 1, 0] - ego[row, 0])
    vy = (agent[row + 1, 1] - agent[row, 1]) - (ego[row + 1, 1] - ego[row, 1])
    radius_a, radius_b = math.hypot(halves[0, 0], halves[0, 1]), math.hypot(halves[other, 0], halves[other, 1])
    turning = radius_a * abs(ego[row + 1, 2] - ego[row, 2]) + radius_b * abs(agent[row + 1, 2] - agent[row, 2])
    bound = math.hypot(vx, vy) + turning
    gap = _gap_at(0.0, ego, agent, halves, row, other)
    if gap <= 0.0:
        return 0.0
    if gap > bound:
        return math.inf
    share, shortest = 0.0, _SHORTEST_CONTACT_S / duration
    while share < 1.0:
        before = share
        share = min(share + max(gap / bound, shortest), 1.0)
        gap = _gap_at(share, ego, agent, halves, row, other)
        if gap <= 0.0:
            apart, touching = before, share
            for _ in range(_BISECTIONS):
                middle = 0.5 * (apart + touching)
                if _gap_at(middle, ego, agent, halves, row, other) <= 0.0:
                    touching = middle
                else:
                    apart = middle
            return touching
    return math.inf


@compiled_above(PLAIN_ELEMENTS)
def first_contacts(times_s: Float64, states: Float64, halves: Float64, present: Bool) -> Float64:
    """Return the times (N,) in seconds at which each agent first touches the ego.

    They are inf where it never does, and for the ego.

    Args:
        times_s: (T,) times of the stamps.
        states: (N, T, 5) as `StateLog.kernel_arrays` gives them; the ego is row 0.
        halves: (N, 2) half lengths and half widths.
        present: (N, T) whether an actor exists; a step counts where the agent exists at both its ends.
    """
    found = np.full(len(states), math.inf)
    for other in range(1, len(states)):
        for row in range(len(times_s)):
            if not present[other, row]:
                continue
            if row + 1 < len(times_s) and present[other, row + 1]:
                duration = times_s[row + 1] - times_s[row]
                share = _contact_in_step(states[0], states[other], halves, row, other, duration)
                if share <= 1.0:
                    found[other] = times_s[row] + share * duration
                    break
                continue
            dx, dy = states[other, row, 0] - states[0, row, 0], states[other, row, 1] - states[0, row, 1]
            yaw_a, yaw_b = states[0, row, 2], states[other, row, 2]
            half = halves[other]
            if signed_gap(dx, dy, yaw_a, yaw_b, halves[0, 0], halves[0, 1], half[0], half[1]) <= 0.0:
                found[other] = times_s[row]
                break
    return found
