"""Lanes through crossings, and their right of way."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import shapely

from mirror.arrays import Float64
from mirror.portable import arrays, scalars
from mirror.synth.roads.crossing import Corner, Crossing
from mirror.synth.roads.lanes import WALK_MPS, Port
from mirror.traffic.lanes.network import Lane

_STEP_M: Final = 0.3
_STRAIGHT_RAD: Final = math.radians(30.0)
_TURN_MPS: Final = 6.5
_SAME_M: Final = 0.01
_FROM_KERB_M: Final = 1.2


@dataclass(frozen=True)
class Turning:
    """A lane through a crossing.

    Attributes:
        lane: the lane.
        start: end of the lane that arrives.
        goal: beginning of the lane that leaves.
        turn_rad: change of heading along it, counter-clockwise.
    """

    lane: Lane
    start: Port
    goal: Port
    turn_rad: float


def cubic_curve(
    start: Float64, heading_rad: float, goal: Float64, goal_heading_rad: float, step_m: float = _STEP_M
) -> Float64:
    """Return a cubic curve (N, 2) between two positions with headings.

    It is an arc if both are equally far from their corner.
    """
    turn = _wrap_angle(goal_heading_rad - heading_rad)
    ahead = np.array([scalars.cos(heading_rad), scalars.sin(heading_rad)])
    after = np.array([scalars.cos(goal_heading_rad), scalars.sin(goal_heading_rad)])
    gap = goal - start
    if abs(turn) < _STRAIGHT_RAD or abs(turn) > math.pi - _STRAIGHT_RAD:
        first = second = float(arrays.hypot(*gap)) / 3.0
    else:
        share = 4.0 / 3.0 * scalars.tan(0.25 * abs(turn)) / scalars.tan(0.5 * abs(turn))
        sin = ahead[0] * after[1] - ahead[1] * after[0]
        first = share * (gap[0] * after[1] - gap[1] * after[0]) / sin
        second = share * (ahead[0] * gap[1] - ahead[1] * gap[0]) / sin
        least = 0.2 * float(arrays.hypot(*gap))
        first, second = max(first, least), max(second, least)
    control = np.array([start, start + first * ahead, goal - second * after, goal])
    fine = _evaluate_cubic(control, np.linspace(0.0, 1.0, 257))
    along = np.concatenate([[0.0], np.cumsum(arrays.hypot(*np.diff(fine, axis=0).T))])
    count = max(math.ceil(along[-1] / step_m), 2)
    share_at = np.interp(np.linspace(0.0, along[-1], count + 1), along, np.linspace(0.0, 1.0, 257))
    return _evaluate_cubic(control, share_at)


def _evaluate_cubic(control: Float64, share: Float64) -> Float64:
    t = share[:, None]
    return (
        (1 - t) ** 2 * (1 - t) * control[0]
        + 3 * (1 - t) ** 2 * t * control[1]
        + 3 * (1 - t) * t**2 * control[2]
        + t**2 * t * control[3]
    )


def _wrap_angle(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def build_turnings(crossing: Crossing, ports: Sequence[Port], lanes: Mapping[str, Lane]) -> list[Turning]:
    """Build vehicle lanes through a crossing, from each arriving lane to lanes of the same use on other arms."""
    turnings = []
    for start in ports:
        use = lanes[start.lane_id].use
        if not start.arrives or use not in ("drive", "cycle"):
            continue
        for goal in ports:
            if goal.arrives or goal.arm == start.arm or lanes[goal.lane_id].use != use:
                continue
            line = cubic_curve(start.place, start.heading_rad, goal.place, goal.heading_rad)
            turn = _wrap_angle(goal.heading_rad - start.heading_rad)
            before, after = lanes[start.lane_id], lanes[goal.lane_id]
            fastest = min(before.speed_mps, after.speed_mps)
            speed = fastest if abs(turn) < _STRAIGHT_RAD else min(fastest, _TURN_MPS)
            lane = Lane(
                f"{crossing.name}.{start.lane_id}>{goal.lane_id}", "turn", line,
                min(before.width_m, after.width_m), speed, (goal.lane_id,),
            )  # fmt: skip
            turnings.append(Turning(lane, start, goal, turn))
    return turnings


def link_lanes(ports: Sequence[Port]) -> dict[str, tuple[str, ...]]:
    """Return the successors of lanes that continue directly in another lane, where lanes branch and merge."""
    return {
        start.lane_id: tuple(
            goal.lane_id for goal in ports if not goal.arrives and arrays.hypot(*(goal.place - start.place)) < _SAME_M
        )
        for start in ports
        if start.arrives
    }


def assign_right_of_way(
    crossing: Crossing, turnings: Sequence[Turning], crosses: Mapping[int, tuple[str, ...]]
) -> list[Lane]:
    """Convert turnings to lanes that name the lanes to which they yield.

    Args:
        crossing: the crossing.
        turnings: turnings of the crossing.
        crosses: for each arm, the ids of the walking lanes over its zebra.
    """
    lines = [shapely.LineString(turning.lane.line) for turning in turnings]
    lanes = []
    for turning, line in zip(turnings, lines):
        first = [
            other.lane.lane_id
            for other, other_line in zip(turnings, lines)
            if other.start.arm != turning.start.arm
            and _goes_first(crossing, other, turning)
            and (other.goal.lane_id == turning.goal.lane_id or shapely.intersects(line, other_line))
        ]
        straight = abs(turning.turn_rad) < _STRAIGHT_RAD
        if crossing.control != "signal" or not straight:
            first += crosses.get(turning.goal.arm, ())
        lanes.append(replace(turning.lane, yields_to=tuple(first)))
    return lanes


def _goes_first(crossing: Crossing, other: Turning, mine: Turning) -> bool:
    """Return whether ``mine`` has to wait for ``other``."""
    other_arm, arm = crossing.arms[other.start.arm], crossing.arms[mine.start.arm]
    if other_arm.minor != arm.minor:
        return arm.minor
    if other_arm.street is not arm.street and crossing.control == "signal":
        return False
    # With equal priority, left turns wait for all others.
    return mine.turn_rad > _STRAIGHT_RAD and other.turn_rad <= _STRAIGHT_RAD


def _corner_path(start: Port, goal: Port, corner: Corner | None) -> Float64:
    """The walking path around a corner, close to its kerb; a straight line where there is no corner."""
    if corner is None:
        return cubic_curve(start.place, start.heading_rad, goal.place, goal.heading_rad)
    out = corner.inner - corner.centre
    out = out / arrays.hypot(*out)
    middle = corner.centre + (corner.radius_m - _FROM_KERB_M) * out
    turn = _wrap_angle(goal.heading_rad - start.heading_rad)
    heading = scalars.atan2(out[1], out[0]) - math.copysign(0.5 * math.pi, -turn)
    before = cubic_curve(start.place, start.heading_rad, middle, heading)
    return np.vstack([before, cubic_curve(middle, heading, goal.place, goal.heading_rad)[1:]])


def build_footways(
    crossing: Crossing, ports: Sequence[Port], zebras: Sequence[bool]
) -> tuple[list[Lane], dict[int, tuple[str, ...]]]:
    """Build walking lanes around a crossing's corners and over its zebras, linked with each other and the pavements.

    Args:
        crossing: the crossing.
        ports: ends of its walking lanes.
        zebras: for each arm, whether it has a zebra crossing.

    Returns:
        The lanes, and for each arm the ids of the lanes over its zebra.
    """
    at = {(port.arm, port.left, port.arrives): port for port in ports}
    paths: list[tuple[Lane, tuple[int, bool], tuple[int, bool]]] = []
    lanes_over: dict[int, tuple[str, ...]] = {}
    for number in range(len(crossing.arms)):
        after = (number + 1) % len(crossing.arms)
        corner = next((corner for corner in crossing.corners if corner.first == number), None)
        for start, goal in (((number, True), (after, False)), ((after, False), (number, True))):
            line = _corner_path(at[(*start, True)], at[(*goal, False)], corner)
            name = f"{crossing.name}.walk{start[0]}{'l' if start[1] else 'r'}>{goal[0]}{'l' if goal[1] else 'r'}"
            paths.append((Lane(name, "walk", line, 1.5, WALK_MPS), start, goal))
        if zebras[number]:
            ids = []
            for left in (True, False):
                begin, end = at[number, left, True], at[number, not left, False]
                count = math.ceil(float(arrays.hypot(*(end.place - begin.place))) / 0.9)
                line = begin.place + np.linspace(0.0, 1.0, count + 1)[:, None] * (end.place - begin.place)
                name = f"{crossing.name}.cross{number}{'l' if left else 'r'}"
                paths.append((Lane(name, "cross", line, 3.0, WALK_MPS), (number, left), (number, not left)))
                ids.append(name)
            lanes_over[number] = tuple(ids)
    lanes = []
    for lane, _, goal in paths:
        onwards = (other.lane_id for other, begin, _ in paths if begin == goal and other.use != lane.use)
        lanes.append(replace(lane, successors=(at[(*goal, False)].lane_id, *onwards)))
    return lanes, lanes_over
