"""Compiled parts of the presets: overlaps at stamps, and time to collision as nuPlan and NAVSIM v2 define it."""

from __future__ import annotations

import math

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.compiled import compiled_above, inner_njit
from mirror.metrics.safety.rectangle_kernels import PLAIN_ELEMENTS, contact_time, signed_gap


@inner_njit
def _overlap(ego: Float64, agent: Float64, halves: Float64, other: int) -> bool:
    """Return whether two boxes (x, y, yaw) touch."""
    dx, dy = agent[0] - ego[0], agent[1] - ego[1]
    reach = math.hypot(halves[0, 0], halves[0, 1]) + math.hypot(halves[other, 0], halves[other, 1])
    if dx * dx + dy * dy > reach * reach:
        return False
    gap = signed_gap(dx, dy, ego[2], agent[2], halves[0, 0], halves[0, 1], halves[other, 0], halves[other, 1])
    return bool(gap <= 0.0)


@compiled_above(PLAIN_ELEMENTS)
def overlaps_at_stamps(states: Float64, halves: Float64, present: Bool) -> Bool:
    """Mark which of N actors touch the ego at each of T stamps: (N, T), False for the ego."""
    found = np.zeros(present.shape, np.bool_)
    for other in range(1, len(states)):
        for row in range(states.shape[1]):
            if present[other, row]:
                found[other, row] = _overlap(states[0, row], states[other, row], halves, other)
    return found


@compiled_above(PLAIN_ELEMENTS)
def bearings(states: Float64, rear_axle_to_center: float) -> Float64:
    """Return angles (N, T), 0 to pi, between the ego's heading and the direction from its rear axle to each agent."""
    found = np.zeros(states.shape[:2])
    for row in range(states.shape[1]):
        cos, sin = math.cos(states[0, row, 2]), math.sin(states[0, row, 2])
        for other in range(1, len(states)):
            dx, dy = states[other, row, 0] - states[0, row, 0], states[other, row, 1] - states[0, row, 1]
            ahead = dx * cos + dy * sin + rear_axle_to_center
            found[other, row] = math.atan2(abs(dy * cos - dx * sin), ahead)
    return found


@compiled_above(PLAIN_ELEMENTS)
def forward_speed(states: Float64) -> Float64:
    """Return the magnitude (T,) of the ego's velocity along its heading: the speed of its rear axle."""
    found = np.empty(states.shape[1])
    for row in range(states.shape[1]):
        yaw = states[0, row, 2]
        found[row] = abs(states[0, row, 3] * math.cos(yaw) + states[0, row, 4] * math.sin(yaw))
    return found


@compiled_above(PLAIN_ELEMENTS)
def nuplan_steps(
    states: Float64, halves: Float64, considered: Bool, speed: Float64, stopped: float, step: float, steps: int
) -> tuple[Int64, Int64]:
    """Return the number of steps (T,) until the boxes touch (0: never), and the touched agent (T,), -1: none.

    Both move along their headings at the magnitudes of their speeds.

    Args:
        states: (N, T, 5) as `StateLog.kernel_arrays` gives them.
        halves: (N, 2) half lengths and half widths.
        considered: (N, T) agents that count.
        speed: (T,) magnitude of the ego's speed.
        stopped: no value where the ego is at most this fast.
        step: duration of a step.
        steps: number of steps.
    """
    found, who = np.zeros(len(speed), np.int64), np.full(len(speed), -1)
    ego, agent = np.empty(3), np.empty(3)
    for row in range(len(speed)):
        if speed[row] <= stopped:
            continue
        own = states[0, row]
        best = steps + 1
        for other in range(1, len(states)):
            if not considered[other, row]:
                continue
            one = states[other, row]
            pace = math.hypot(one[3], one[4])
            vx = math.cos(one[2]) * pace - math.cos(own[2]) * speed[row]
            vy = math.sin(one[2]) * pace - math.sin(own[2]) * speed[row]
            contact = contact_time(
                one[0] - own[0], one[1] - own[1], vx, vy, own[2], one[2],
                halves[0, 0], halves[0, 1], halves[other, 0], halves[other, 1],
            )  # fmt: skip
            # Nothing touches before the exact contact; one step of it is left to rounding.
            if contact >= step * best:
                continue
            for number in range(max(int(contact / step) - 1, 1), best):
                time = step * number
                ego[0] = own[0] + math.cos(own[2]) * speed[row] * time
                ego[1] = own[1] + math.sin(own[2]) * speed[row] * time
                agent[0] = one[0] + math.cos(one[2]) * pace * time
                agent[1] = one[1] + math.sin(one[2]) * pace * time
                ego[2], agent[2] = own[2], one[2]
                if _overlap(ego, agent, halves, other):
                    best = number
                    found[row], who[row] = number, other
                    break
    return found, who


@compiled_above(PLAIN_ELEMENTS)
def navsim_violation(
    times: Float64,
    states: Float64,
    halves: Float64,
    present: Bool,
    rear_m: float,
    between: Bool,
    speed: Float64,
    stopped: float,
    offsets: Float64,
    cone: tuple[float, float],
    excluded: Bool,
) -> tuple[int, int]:
    """Find the first stamp and agent at which the ego, at constant velocity, meets the agent's logged future.

    Both are -1 if there is none.

    Args:
        times: (T,) times of the stamps.
        states: (N, T, 5) as `StateLog.kernel_arrays` gives them.
        halves: (N, 2) half lengths and half widths.
        present: (N, T) presence.
        rear_m: distance from the ego's rear axle forward to its centre.
        between: (T,) whether the ego is in several lanes, outside the drivable area, or in a junction.
        speed: (T,) magnitude of the ego's speed.
        stopped: no violation where the ego is slower.
        offsets: (K,) how far ahead the boxes are compared, seconds.
        cone: angles below which an agent is ahead, and above which it is behind.
        excluded: (N,) agents that do not count; agents that were met beside or behind are added.
    """  # fmt: skip
    agent, ego = np.empty(3), np.empty(3)
    last = times[-1] - offsets[-1] + 1e-9
    for row in range(len(times)):
        if times[row] > last:
            break
        own = states[0, row]
        cos, sin = math.cos(own[2]), math.sin(own[2])
        after = row
        for number in range(len(offsets)):
            time = times[row] + offsets[number]
            while after + 1 < len(times) and times[after + 1] <= time + 1e-9:
                after += 1
            rest = 0.0
            if after + 1 < len(times):
                rest = min(max((time - times[after]) / (times[after + 1] - times[after]), 0.0), 1.0)
            ego[0] = own[0] + cos * speed[row] * offsets[number]
            ego[1] = own[1] + sin * speed[row] * offsets[number]
            ego[2] = own[2]
            for other in range(1, len(states)):
                if excluded[other] or speed[row] < stopped or not present[other, after]:
                    continue
                one = states[other, after]
                agent[0], agent[1], agent[2] = one[0], one[1], one[2]
                if rest > 1e-6:
                    if not present[other, after + 1]:
                        continue
                    for value in range(3):
                        agent[value] += rest * (states[other, after + 1, value] - one[value])
                if not _overlap(ego, agent, halves, other):
                    continue
                dx, dy = agent[0] - own[0], agent[1] - own[1]
                bearing = math.atan2(abs(dy * cos - dx * sin), dx * cos + dy * sin + rear_m)
                if bearing < cone[0] or (between[row] and bearing <= cone[1]):
                    return row, other
                excluded[other] = True
    return -1, -1
