"""Builds the road network of a street plan: lanes with successors, right of way and heights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays
from mirror.synth.roads.crossing import CrossedStreet, Crossing
from mirror.synth.roads.lanes import Port, build_lanes
from mirror.synth.roads.turnings import assign_right_of_way, build_footways, build_turnings, link_lanes
from mirror.traffic.lanes.network import Lane, Network

_CYCLE_S: Final = 60.0
_GREEN_S: Final = np.array([[0.0, 24.0], [30.0, 54.0], [30.0, 46.0], [0.0, 16.0]])
"""Start and end of green for the first street, the second street, the zebras over the first and over the second."""
_ON_FOOT: Final = 2


def build_network(
    streets: Sequence[CrossedStreet],
    crossings: Sequence[Crossing],
    feet: bool,
    height_m: Callable[[Float64, Float64], Float64],
) -> Network:
    """Build all lanes of a plan.

    Args:
        streets: the streets.
        crossings: the crossings.
        feet: whether the streets have pavements.
        height_m: height of the ground as a function of x and y.
    """
    lanes: dict[str, Lane] = {}
    ports: dict[str, list[Port]] = {crossing.name: [] for crossing in crossings}
    for street in streets:
        for lane, meets in build_lanes(street, crossings, feet):
            lanes[lane.lane_id] = lane
            for port in meets:
                ports[port.crossing].append(port)
    for crossing in crossings:
        _add_crossing_lanes(crossing, ports[crossing.name], lanes, feet)
    lifted = {name: replace(lane, line=_add_heights(lane.line, height_m)) for name, lane in lanes.items()}
    signals = any(crossing.control == "signal" for crossing in crossings)
    return Network(lifted, _GREEN_S if signals else np.zeros((0, 2)), _CYCLE_S)


def _add_crossing_lanes(crossing: Crossing, ports: Sequence[Port], lanes: dict[str, Lane], feet: bool) -> None:
    """Add the lanes of a crossing; set successors, signals and right of way of the lanes that arrive at it."""
    if crossing.control == "joint":
        _link_joint(crossing, ports, lanes)
        return
    walks = [port for port in ports if lanes[port.lane_id].use == "walk"]
    wheels = [port for port in ports if lanes[port.lane_id].use in ("drive", "cycle")]
    footpaths: list[Lane] = []
    over: dict[int, tuple[str, ...]] = {}
    if feet:
        footpaths, over = build_footways(crossing, walks, [arm.zebra for arm in crossing.arms])
    through = assign_right_of_way(crossing, build_turnings(crossing, wheels, lanes), over)
    signal = crossing.control == "signal"
    groups = {name: _ON_FOOT + crossing.group(arm) for arm, names in over.items() for name in names if signal}
    footpaths = [replace(lane, signal=groups.get(lane.lane_id)) for lane in footpaths]
    new_lanes = {lane.lane_id: lane for lane in (*through, *footpaths)}
    lanes.update(new_lanes)
    for port in ports:
        if not port.arrives:
            continue
        lane = lanes[port.lane_id]
        if lane.use == "walk":
            follow = tuple(other.lane_id for other in footpaths if arrays.hypot(*(other.line[0] - port.place)) < 1e-6)
            lanes[lane.lane_id] = replace(lane, successors=follow)
            continue
        follow = tuple(other.lane_id for other in through if f".{lane.lane_id}>" in f".{other.lane_id}")
        lanes[lane.lane_id] = replace(
            lane,
            successors=follow,
            signal=crossing.group(port.arm) if signal else None,
            yields_to=() if signal else over.get(port.arm, ()),
        )


def _link_joint(crossing: Crossing, ports: Sequence[Port], lanes: dict[str, Lane]) -> None:
    """Link the lanes at a junction without crossing traffic; merging traffic yields."""
    after = link_lanes(ports)
    for port in ports:
        if port.arrives:
            merging = tuple(
                other.lane_id
                for other in ports
                if other.arrives
                and other.arm != port.arm
                and set(after[other.lane_id]) & set(after[port.lane_id])
                and crossing.arms[port.arm].street is not _through_street(crossing)
            )
            lanes[port.lane_id] = replace(lanes[port.lane_id], successors=after[port.lane_id], yields_to=merging)


def _through_street(crossing: Crossing) -> CrossedStreet:
    """The street that continues through the crossing."""
    names = [arm.street.name for arm in crossing.arms]
    return next(arm.street for arm in crossing.arms if names.count(arm.street.name) == 2)


def _add_heights(line: Float64, height_m: Callable[[Float64, Float64], Float64]) -> Float64:
    return np.c_[line, height_m(line[:, 0], line[:, 1])]
