"""Compiled search for the least time to collision of the ego with each agent over continuous time."""

from __future__ import annotations

import math

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.compiled import compiled_above, inner_njit
from mirror.metrics.safety.rectangle_kernels import PLAIN_ELEMENTS, contact_time

# Longest distance between samples. Between samples the least value is refined by bisection and golden section.
_SAMPLE_S = 0.005
_REFINEMENTS = 30
_GOLDEN = 0.3819660112501051


@inner_njit
def time_to_collision_at(ego: Float64, agent: Float64, halves: Float64, row: int, other: int, share: float) -> float:
    """Return the time to collision at a fraction of the step from ``row`` to the next row.

    Both boxes keep their velocities of that instant.
    """
    after = min(row + 1, len(ego) - 1)
    rest = 1.0 - share
    dx = rest * (agent[row, 0] - ego[row, 0]) + share * (agent[after, 0] - ego[after, 0])
    dy = rest * (agent[row, 1] - ego[row, 1]) + share * (agent[after, 1] - ego[after, 1])
    vx = rest * (agent[row, 3] - ego[row, 3]) + share * (agent[after, 3] - ego[after, 3])
    vy = rest * (agent[row, 4] - ego[row, 4]) + share * (agent[after, 4] - ego[after, 4])
    yaw_a = rest * ego[row, 2] + share * ego[after, 2]
    yaw_b = rest * agent[row, 2] + share * agent[after, 2]
    return float(
        contact_time(dx, dy, vx, vy, yaw_a, yaw_b, halves[0, 0], halves[0, 1], halves[other, 0], halves[other, 1])
    )


@inner_njit
def _lower_bound(ego: Float64, agent: Float64, row: int, radius: float) -> float:
    """No time to collision within the step from ``row`` to the next is less than this."""
    ax, ay = agent[row, 0] - ego[row, 0], agent[row, 1] - ego[row, 1]
    bx, by = agent[row + 1, 0] - ego[row + 1, 0], agent[row + 1, 1] - ego[row + 1, 1]
    ux, uy = bx - ax, by - ay
    square = ux * ux + uy * uy
    nearest = min(max(-(ax * ux + ay * uy) / square, 0.0), 1.0) if square > 0.0 else 0.0
    distance = math.hypot(ax + nearest * ux, ay + nearest * uy) - radius
    if distance <= 0.0:
        return 0.0
    speed = max(
        math.hypot(agent[row, 3] - ego[row, 3], agent[row, 4] - ego[row, 4]),
        math.hypot(agent[row + 1, 3] - ego[row + 1, 3], agent[row + 1, 4] - ego[row + 1, 4]),
    )
    return distance / speed if speed > 0.0 else math.inf


@inner_njit
def _refine(
    ego: Float64, agent: Float64, halves: Float64, row: int, other: int, low: float, high: float, best: float, at: float
) -> tuple[float, float]:
    """Golden section search between two shares of a step; returns the least value and its share."""
    left, right = low + _GOLDEN * (high - low), high - _GOLDEN * (high - low)
    at_left = time_to_collision_at(ego, agent, halves, row, other, left)
    at_right = time_to_collision_at(ego, agent, halves, row, other, right)
    for _ in range(_REFINEMENTS):
        if at_left < best:
            best, at = at_left, left
        if at_right < best:
            best, at = at_right, right
        if at_left <= at_right:
            high, right, at_right = right, left, at_left
            left = low + _GOLDEN * (high - low)
            at_left = time_to_collision_at(ego, agent, halves, row, other, left)
        else:
            low, left, at_left = left, right, at_right
            right = high - _GOLDEN * (high - low)
            at_right = time_to_collision_at(ego, agent, halves, row, other, right)
    return best, at


@inner_njit
def _least_in_step(
    ego: Float64, agent: Float64, halves: Float64, row: int, other: int, duration: float, best: float
) -> tuple[float, float]:
    """Least value below ``best`` within a step and its share of the step; (best, -1) where there is none."""
    count = max(math.ceil(duration / _SAMPLE_S), 1)
    at, least, least_sample = -1.0, math.inf, -1
    before = math.inf
    for sample in range(count + 1):
        share = sample / count
        value = time_to_collision_at(ego, agent, halves, row, other, share)
        if value == 0.0:
            # They touch: no value is less, and the first contact is the instant.
            touching, apart = share, max(sample - 1, 0) / count
            if time_to_collision_at(ego, agent, halves, row, other, apart) == 0.0:
                return 0.0, apart
            for _ in range(_REFINEMENTS):
                middle = 0.5 * (touching + apart)
                if time_to_collision_at(ego, agent, halves, row, other, middle) == 0.0:
                    touching = middle
                else:
                    apart = middle
            return 0.0, touching
        if sample > 0 and math.isinf(value) != math.isinf(before):
            # The course to a collision begins or ends here, and the value jumps: find its last finite instant.
            finite, infinite = (share, share - 1.0 / count) if math.isinf(before) else (share - 1.0 / count, share)
            for _ in range(_REFINEMENTS):
                middle = 0.5 * (finite + infinite)
                if math.isinf(time_to_collision_at(ego, agent, halves, row, other, middle)):
                    infinite = middle
                else:
                    finite = middle
            edge = time_to_collision_at(ego, agent, halves, row, other, finite)
            if edge < best:
                best, at = edge, finite
        if value < least:
            least, least_sample = value, sample
        before = value
    # The least sample may lie above an earlier step's value while the minimum beside it lies below.
    if least < best:
        best, at = least, least_sample / count
    if least_sample >= 0 and best > 0.0:
        low, high = max(least_sample - 1, 0) / count, min(least_sample + 1, count) / count
        best, at = _refine(ego, agent, halves, row, other, low, high, best, at)
    return best, at


@compiled_above(PLAIN_ELEMENTS)
def least_times_to_collision(
    times_s: Float64, states: Float64, halves: Float64, present: Bool, horizon_s: float
) -> tuple[Float64, Float64]:
    """Return the least time to collision (N,) of the ego with each agent, and when it occurs (N,).

    Both are inf where no value within the horizon exists, and for the ego. Arguments are those of `first_contacts`.
    """
    values, instants = np.full(len(states), math.inf), np.full(len(states), math.inf)
    ego, own_radius = states[0], math.hypot(halves[0, 0], halves[0, 1])
    for other in range(1, len(states)):
        agent, radius = states[other], own_radius + math.hypot(halves[other, 0], halves[other, 1])
        best = np.nextafter(horizon_s, math.inf)
        for row in range(len(times_s)):
            if best == 0.0:
                break
            if not present[other, row]:
                continue
            if row + 1 < len(times_s) and present[other, row + 1]:
                if _lower_bound(ego, agent, row, radius) >= best:
                    continue
                duration = times_s[row + 1] - times_s[row]
                value, share = _least_in_step(ego, agent, halves, row, other, duration, best)
                instant = times_s[row] + share * duration
            else:
                value, share = time_to_collision_at(ego, agent, halves, row, other, 0.0), 0.0
                instant = times_s[row]
            if share >= 0.0 and value < best:
                best = values[other] = value
                instants[other] = instant
    return values, instants


@compiled_above(PLAIN_ELEMENTS)
def times_to_collision(states: Float64, halves: Float64, present: Bool) -> Float64:
    """Return the time to collision (T, N) of the ego with each agent at each stamp.

    It is inf for none, for absent agents and for the ego itself.
    """
    actors, stamps = present.shape
    found = np.full((stamps, actors), math.inf)
    for other in range(1, actors):
        for row in range(stamps):
            if present[other, row]:
                found[row, other] = time_to_collision_at(states[0], states[other], halves, row, other, 0.0)
    return found
