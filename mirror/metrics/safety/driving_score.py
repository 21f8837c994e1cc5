"""PDMS and EPDMS: the driving scores of NAVSIM, as presets of named constants.

    PDMS  = NC DAC (5 EP + 5 TTC + 2 C) / 12
    EPDMS = NC DAC DDC TLC (5 EP + 5 TTC + 2 LK + 2 C) / 14

NC: no at-fault collision; DAC: drivable area compliance; DDC: driving direction compliance; TLC: traffic light
compliance; EP: ego progress; TTC: time to collision; LK: lane keeping; C: comfort. NAVSIM's extended comfort compares
two plans of the same instant, which a log of states does not hold. Its weight of 2 is left out of EPDMS, as NAVSIM's
own scorer of single plans does. NAVSIM scores plans of 4 s; here the whole log is scored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Bool
from mirror.metrics.safety.collisions import Collision
from mirror.metrics.safety.lanes import LanePositions, driven_steps
from mirror.metrics.safety.progress import Progress
from mirror.metrics.safety.state_log import StateLog

PDMS_WEIGHTS: Final[Mapping[str, float]] = {"progress": 5.0, "time_to_collision": 5.0, "comfort": 2.0}
EPDMS_WEIGHTS: Final[Mapping[str, float]] = {**PDMS_WEIGHTS, "lane_keeping": 2.0}
DIRECTION_WINDOW_S: Final = 1.0
DIRECTION_COMPLIANT_M: Final = 2.0
DIRECTION_VIOLATED_M: Final = 6.0
"""Driven against the direction within the window: below the first 1, below the second 0.5, else 0."""
LANE_KEEPING_M: Final = 0.5
LANE_KEEPING_S: Final = 2.0
"""Lane keeping fails where the ego is farther than this from its route for this long, junctions left out."""
LEAST_REFERENCE_M: Final = 5.0
"""Progress counts as complete where the reference itself comes no farther."""
STATIC_CATEGORIES: Final = frozenset({"barrier", "traffic_cone", "sign", "object"})
"""Categories of objects; an at-fault collision with one gives 0.5 instead of 0."""


@dataclass(frozen=True)
class DrivingScore:
    """A driving score with its factors, each from 0 to 1.

    Attributes:
        pdms: the score of NAVSIM v1.
        epdms: the score of NAVSIM v2 without its extended comfort.
        no_collision: NC.
        drivable_area: DAC.
        driving_direction: DDC.
        traffic_lights: TLC.
        progress: EP.
        time_to_collision: TTC.
        lane_keeping: LK.
        comfort: C.
    """

    pdms: float
    epdms: float
    no_collision: float
    drivable_area: float
    driving_direction: float
    traffic_lights: float
    progress: float
    time_to_collision: float
    lane_keeping: float
    comfort: float


def combine_factors(
    *,
    no_collision: float,
    drivable_area: float,
    driving_direction: float,
    traffic_lights: float,
    progress: float,
    time_to_collision: float,
    lane_keeping: float,
    comfort: float,
) -> DrivingScore:
    """Combine the factors."""
    factors = {
        "progress": progress,
        "time_to_collision": time_to_collision,
        "comfort": comfort,
        "lane_keeping": lane_keeping,
    }

    def mean(weights: Mapping[str, float]) -> float:
        return sum(weight * factors[name] for name, weight in weights.items()) / sum(weights.values())

    gate = no_collision * drivable_area
    return DrivingScore(
        pdms=gate * mean(PDMS_WEIGHTS),
        epdms=gate * driving_direction * traffic_lights * mean(EPDMS_WEIGHTS),
        no_collision=no_collision,
        drivable_area=drivable_area,
        driving_direction=driving_direction,
        traffic_lights=traffic_lights,
        progress=progress,
        time_to_collision=time_to_collision,
        lane_keeping=lane_keeping,
        comfort=comfort,
    )


def collision_factor(collisions: Sequence[Collision]) -> float:
    """Return NAVSIM's no-collision factor (NC): 0 for a collision at fault, 0.5 if only with objects, else 1."""
    at_fault = [one for one in collisions if one.is_at_fault]
    if not at_fault:
        return 1.0
    return 0.5 if all(one.category in STATIC_CATEGORIES for one in at_fault) else 0.0


def direction_factor(log: StateLog, off_route: Bool) -> float:
    """Score NAVSIM's driving direction compliance (DDC) from the distance driven off the route within one second.

    Args:
        log: states; only the ego is read.
        off_route: (T,) whether the ego's centre is in no lane of the route, and not in a junction.
    """
    steps = np.where(off_route, np.concatenate([[0.0], driven_steps(log)]), 0.0)
    sums = np.concatenate([[0.0], np.cumsum(steps)])
    times = log.times_s
    begin = np.searchsorted(times, times - DIRECTION_WINDOW_S - 1e-9)
    worst = float((sums[1:] - sums[begin]).max())
    if worst < DIRECTION_COMPLIANT_M:
        return 1.0
    return 0.5 if worst < DIRECTION_VIOLATED_M else 0.0


def lane_keeping_factor(log: StateLog, progress: Progress, positions: LanePositions) -> float:
    """Return NAVSIM's lane keeping (LK): 0 if the ego is off its route's middle for two seconds, else 1.

    Stamps in junctions are left out.
    """
    outside = np.flatnonzero(~positions.in_junction)
    far = np.abs(progress.offset_m[outside]) > LANE_KEEPING_M
    step = float(np.median(np.diff(log.times_s))) if len(log.stamps_ns) > 1 else LANE_KEEPING_S
    needed, run = max(int(np.ceil(LANE_KEEPING_S / step - 1e-9)), 1), 0
    for is_far in far.tolist():
        run = run + 1 if is_far else 0
        if run >= needed:
            return 0.0
    return 1.0


def progress_factor(progress_m: float, reference_m: float) -> float:
    """Return the progress as a share of a reference's progress, from 0 to 1 (NAVSIM's EP)."""
    if reference_m <= LEAST_REFERENCE_M:
        return 1.0
    return min(max(progress_m / reference_m, 0.0), 1.0)
