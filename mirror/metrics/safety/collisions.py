"""Collisions of the ego in a state log: first contact, impact speed, kind, and fault as nuPlan assigns it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.errors import UsageError
from mirror.metrics.safety.state_log import StateLog

STOPPED_MPS: Final = 0.05
"""At this speed or less an actor is stopped (nuPlan)."""
BEHIND_DEG: Final = 150.0
"""An agent is behind if it is seen from the ego's rear axle at more than this angle from the heading (nuPlan)."""
BUMPER_M: Final = 1e-3
"""An agent this near to the front bumper at first contact is hit by the bumper."""


class CollisionKind(StrEnum):
    """Kinds of collisions, in the order in which they are tested (nuPlan's ``CollisionType``)."""

    STOPPED_EGO = "stopped_ego"
    STOPPED_AGENT = "stopped_agent"
    REAR = "rear"
    FRONT = "front"
    LATERAL = "lateral"


@dataclass(frozen=True)
class Collision:
    """The first contact of the ego with one agent.

    Args:
        agent: id of the agent.
        category: category of the agent.
        stamp_ns: stamp of the first contact.
        impact_speed_mps: norm of the difference of both velocities at the contact.
        kind: what hit what.
        is_at_fault: whether the ego caused it; None where it depends on the lanes and these are not given.
    """

    agent: str
    category: str
    stamp_ns: int
    impact_speed_mps: float
    kind: CollisionKind
    is_at_fault: bool | None


def find_collisions(log: StateLog, *, between_lanes: Bool | None = None) -> tuple[Collision, ...]:
    """Find the first contact of the ego with each agent, in the order of time.

    Boxes are swept over the steps of the log, turning included, so that none is jumped over at any speed. The time is
    exact to a microsecond for contacts that last 0.1 ms or more. An agent that touches the ego at the first stamp
    collides at that stamp. The ego is at fault where its front hits a moving agent, where it hits a stopped agent, and
    where it hits the side of an agent while it is between lanes or outside the drivable area (nuPlan,
    ``no_ego_at_fault_collisions``).

    Args:
        log: states of the ego and the agents.
        between_lanes: (T,) whether the ego is in several lanes or outside the drivable area at each stamp; the stamp
            before a contact decides. None: not known, and lateral collisions have no fault.

    Raises:
        UsageError: ``between_lanes`` has another length than the log.
    """
    from mirror.metrics.safety.collision_kernels import first_contacts

    if between_lanes is not None and np.shape(between_lanes) != log.stamps_ns.shape:
        raise UsageError(
            f"between_lanes has shape {np.shape(between_lanes)}", expected=f"one value a stamp: {log.stamps_ns.shape}"
        )
    states, halves, present = log.kernel_arrays()
    times = log.times_s
    contacts = first_contacts(times, states, halves, present)
    collisions = []
    for agent in sorted(np.flatnonzero(np.isfinite(contacts)), key=lambda index: (contacts[index], index)):
        time = float(contacts[agent])
        row = min(int(np.searchsorted(times, time, side="right")) - 1, len(times) - 1)
        ego_state, agent_state = (_interpolate(times, states[actor], row, time) for actor in (0, agent))
        kind = classify_collision(ego_state, agent_state, halves[0], halves[agent], log)
        lateral = None if between_lanes is None else bool(between_lanes[row])
        collisions.append(
            Collision(
                agent=log.ids[agent],
                category=log.categories[agent],
                stamp_ns=log.stamp_at(time),
                impact_speed_mps=math.hypot(ego_state[3] - agent_state[3], ego_state[4] - agent_state[4]),
                kind=kind,
                is_at_fault=lateral
                if kind is CollisionKind.LATERAL
                else kind in (CollisionKind.FRONT, CollisionKind.STOPPED_AGENT),
            )
        )
    return tuple(collisions)


def _interpolate(times: np.ndarray, states: np.ndarray, row: int, time: float) -> list[float]:
    """State (x, y, yaw, vx, vy) of one actor at a time in the step that begins at a row."""
    if row + 1 == len(times) or time <= times[row]:
        return [float(value) for value in states[row]]
    share = (time - times[row]) / (times[row + 1] - times[row])
    return [float(value) for value in (1.0 - share) * states[row] + share * states[row + 1]]


def classify_collision(
    ego: Sequence[float] | Float64,
    agent: Sequence[float] | Float64,
    ego_half: Float64,
    agent_half: Float64,
    log: StateLog,
    *,
    bumper_m: float = BUMPER_M,
) -> CollisionKind:
    """Classify a contact as nuPlan does.

    Args:
        ego: x, y, yaw, vx, vy of the ego at the contact.
        agent: those of the agent.
        ego_half: half the length and half the width of the ego.
        agent_half: those of the agent.
        log: the log, for the place of the ego's rear axle.
        bumper_m: an agent this near to the front bumper is hit by it.
    """
    from mirror.metrics.safety.rectangle_kernels import signed_gap

    if math.hypot(ego[3], ego[4]) <= STOPPED_MPS:
        return CollisionKind.STOPPED_EGO
    if math.hypot(agent[3], agent[4]) <= STOPPED_MPS:
        return CollisionKind.STOPPED_AGENT
    cos, sin = math.cos(ego[2]), math.sin(ego[2])
    dx, dy = agent[0] - ego[0], agent[1] - ego[1]
    forward = dx * cos + dy * sin + log.rear_axle_to_center_m
    if math.degrees(math.atan2(abs(dy * cos - dx * sin), forward)) > BEHIND_DEG:
        return CollisionKind.REAR
    bumper_x, bumper_y = dx - ego_half[0] * cos, dy - ego_half[0] * sin
    gap = signed_gap(bumper_x, bumper_y, ego[2], agent[2], 0.0, ego_half[1], agent_half[0], agent_half[1])
    return CollisionKind.FRONT if gap <= bumper_m else CollisionKind.LATERAL
