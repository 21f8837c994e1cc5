"""Time to collision and at-fault collisions exactly as nuPlan and NAVSIM v2 define them, with their named constants.

Our own figures (`mirror.metrics.safety.ttc`, `collisions`) are continuous in time. These presets are not: they look at
the stamps of the log only and step through the future, so that figures are comparable with published ones. Sources:
nuplan-devkit, ``time_to_collision_within_bound`` and ``no_ego_at_fault_collisions``; NAVSIM v2, ``pdm_scorer``.

Both need to know where the ego is in several lanes or outside the drivable area (``between_lanes``), and where it is in
a junction: there, agents beside it count too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.errors import UsageError
from mirror.metrics.safety.collisions import Collision, CollisionKind, classify_collision
from mirror.metrics.safety.state_log import StateLog

NUPLAN_STEP_S: Final = 0.1
NUPLAN_HORIZON_S: Final = 3.0
"""The steps go up to this time, which is itself excluded: the last one is 2.9 s."""
NUPLAN_LEAST_TTC_S: Final = 0.95
"""The time to collision is within bound if it is always greater than this."""
MOVING_MPS: Final = 5e-3
"""The ego has no time to collision where it is slower (nuPlan and NAVSIM)."""
AHEAD_DEG: Final = 30.0
"""An agent is ahead if it is seen from the ego's rear axle at less than this angle from the heading."""
BEHIND_DEG: Final = 150.0
"""An agent is behind if it is seen at more than this angle."""
NAVSIM_OFFSETS_S: Final = (0.0, 0.3, 0.6, 0.9)
"""Time ahead for which NAVSIM compares the ego at constant velocity with the agents' logged future."""


@dataclass(frozen=True, eq=False)
class NuplanTimeToCollision:
    """The time to collision of a drive by nuPlan's definition.

    Attributes:
        value_s: (T,) value at each stamp; inf: none within the horizon. 0 at the stamp of an at-fault collision.
        least_s: the least value.
        is_within_bound: all values are greater than `NUPLAN_LEAST_TTC_S`.
        agent: the agent of the least value; None: there is no value.
        stamp_ns: its stamp.
    """

    value_s: Float64
    least_s: float
    is_within_bound: bool
    agent: str | None
    stamp_ns: int | None


@dataclass(frozen=True)
class NavsimTimeToCollision:
    """NAVSIM's time to collision: passed or not.

    Attributes:
        is_within_bound: the ego at constant velocity meets no agent's logged future within 0.9 s, at any stamp.
        agent: the agent that it meets first; None: none.
        stamp_ns: the stamp of that.
    """

    is_within_bound: bool
    agent: str | None
    stamp_ns: int | None


def collisions_at_stamps(log: StateLog, between_lanes: Bool) -> tuple[Collision, ...]:
    """Find collisions as nuPlan does: boxes that touch at a stamp, each agent once, ordered by time.

    Two boxes that pass through each other between stamps are missed, unlike by `find_collisions`.

    Args:
        log: states of the ego and the agents.
        between_lanes: (T,) whether the ego is in several lanes or outside the drivable area.

    Raises:
        UsageError: ``between_lanes`` has another length than the log.
    """
    from mirror.metrics.safety.preset_kernels import overlaps_at_stamps

    _require_rows(log, between_lanes, "between_lanes")
    states, halves, present = log.kernel_arrays()
    touching = overlaps_at_stamps(states, halves, present)
    found = []
    for agent in np.flatnonzero(touching.any(axis=1)).tolist():
        row = int(np.argmax(touching[agent]))
        kind = classify_collision(states[0, row], states[agent, row], halves[0], halves[agent], log, bumper_m=0.0)
        ego, other = states[0, row], states[agent, row]
        found.append(
            Collision(
                agent=log.ids[agent],
                category=log.categories[agent],
                stamp_ns=int(log.stamps_ns[row]),
                impact_speed_mps=math.hypot(ego[3] - other[3], ego[4] - other[4]),
                kind=kind,
                is_at_fault=bool(between_lanes[row])
                if kind is CollisionKind.LATERAL
                else kind in (CollisionKind.FRONT, CollisionKind.STOPPED_AGENT),
            )
        )
    return tuple(sorted(found, key=lambda one: one.stamp_ns))


def nuplan_time_to_collision(log: StateLog, *, between_lanes: Bool, in_junction: Bool) -> NuplanTimeToCollision:
    """Compute the time to collision as nuPlan does.

    At each stamp, ego and agents move along their headings at the magnitudes of their speeds (so a reversing vehicle
    is taken to drive forwards), in steps of 0.1 s below 3 s, until their boxes touch. Agents ahead count; where the ego
    is between lanes or in a junction, all that are not behind. An agent that has touched the ego no longer counts. A
    standing ego has no value. At the stamp of an at-fault collision the value is 0.

    Args:
        log: states of the ego and the agents.
        between_lanes: (T,) whether the ego is in several lanes or outside the drivable area.
        in_junction: (T,) whether its rear axle is in a junction.

    Raises:
        UsageError: an array has another length than the log.
    """
    from mirror.metrics.safety.preset_kernels import bearings, forward_speed, nuplan_steps, overlaps_at_stamps

    _require_rows(log, in_junction, "in_junction")
    at_fault = [one for one in collisions_at_stamps(log, between_lanes) if one.is_at_fault]
    states, halves, present = log.kernel_arrays()
    collided = np.logical_or.accumulate(overlaps_at_stamps(states, halves, present), axis=1)
    bearing = bearings(states, log.rear_axle_to_center_m)
    beside = (between_lanes | in_junction) & (bearing <= math.radians(BEHIND_DEG))
    considered = present & ~collided & ((bearing < math.radians(AHEAD_DEG)) | beside)
    steps = math.ceil(NUPLAN_HORIZON_S / NUPLAN_STEP_S - 1e-9) - 1
    count, who = nuplan_steps(states, halves, considered, forward_speed(states), MOVING_MPS, NUPLAN_STEP_S, steps)
    values = np.where(count > 0, count * NUPLAN_STEP_S, np.inf)
    for one in at_fault:
        row = int(np.searchsorted(log.stamps_ns, one.stamp_ns))
        values[row], who[row] = 0.0, log.ids.index(one.agent)
    row = int(np.argmin(values))
    least = float(values[row])
    none = math.isinf(least)
    return NuplanTimeToCollision(
        value_s=values,
        least_s=least,
        is_within_bound=least > NUPLAN_LEAST_TTC_S,
        agent=None if none else log.ids[who[row]],
        stamp_ns=None if none else int(log.stamps_ns[row]),
    )


def navsim_time_to_collision(log: StateLog, *, between_lanes: Bool, in_junction: Bool) -> NavsimTimeToCollision:
    """Test the time to collision as NAVSIM v2 does.

    At each stamp, the ego alone moves along its heading at the magnitude of its speed; 0, 0.3, 0.6 and 0.9 s later its
    box is compared with the logged boxes of the agents of then. A contact counts if the agent's place of then is ahead
    of the ego; where the ego is between lanes or in a junction, if it is not behind. An agent whose contact does not
    count is left out from then on, and so are agents that touch the ego at the first stamp. Stamps with less than 0.9 s
    after them are not tested. Between stamps the agents' boxes are interpolated.

    Args:
        log: states of the ego and the agents.
        between_lanes: (T,) whether the ego is in several lanes or outside the drivable area.
        in_junction: (T,) whether its rear axle is in a junction.

    Raises:
        UsageError: an array has another length than the log.
    """
    from mirror.metrics.safety.preset_kernels import forward_speed, navsim_violation, overlaps_at_stamps

    for values, name in ((between_lanes, "between_lanes"), (in_junction, "in_junction")):
        _require_rows(log, values, name)
    states, halves, present = log.kernel_arrays()
    excluded = overlaps_at_stamps(states[:, :1], halves, present[:, :1])[:, 0]
    row, agent = navsim_violation(
        log.times_s,
        states,
        halves,
        present,
        log.rear_axle_to_center_m,
        between_lanes | in_junction,
        forward_speed(states),
        MOVING_MPS,
        np.array(NAVSIM_OFFSETS_S),
        (math.radians(AHEAD_DEG), math.radians(BEHIND_DEG)),
        excluded,
    )
    if row < 0:
        return NavsimTimeToCollision(True, None, None)
    return NavsimTimeToCollision(False, log.ids[agent], int(log.stamps_ns[row]))


def _require_rows(log: StateLog, values: Bool, name: str) -> None:
    if np.shape(values) != log.stamps_ns.shape or np.asarray(values).dtype != np.bool_:
        raise UsageError(
            f"{name} has shape {np.shape(values)} and type {np.asarray(values).dtype}",
            expected=f"{log.stamps_ns.shape} bool, one value a stamp",
        )
