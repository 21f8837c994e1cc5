"""Builds the lanes along the streets, between their crossings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays
from mirror.synth.roads.crossing import CrossedStreet, Crossing
from mirror.synth.roads.layouts import Approach, find_approaches
from mirror.synth.roads.section import LaneStrip
from mirror.traffic.lanes.network import Lane

_STEP_M: Final = 1.0
_PARK_CLEAR_M: Final = 6.0
_LEAST_M: Final = 4.0
_BESIDE_M: Final = 4.5
_WALK_SHARE: Final = 0.55
WALK_MPS: Final = 1.4


@dataclass(frozen=True)
class Port:
    """The end of a lane at a crossing.

    Attributes:
        lane_id: id of the lane.
        place: (2,) position of the lane's end, metres.
        heading_rad: heading of the lane's traffic there.
        crossing: name of the crossing.
        arm: index of the arm.
        arrives: whether the lane ends here; otherwise it begins here.
        left: for walking lanes: whether the lane is on the left of the arm, seen outwards.
    """

    lane_id: str
    place: Float64
    heading_rad: float
    crossing: str
    arm: int
    arrives: bool
    left: bool


@dataclass(frozen=True)
class _Limit:
    """One end of a stretch of street between two crossings; ``approach`` is None at the end of the street."""

    station_m: float
    crossing: str = ""
    arm: int = 0
    approach: Approach | None = None


def build_lanes(
    street: CrossedStreet, crossings: Sequence[Crossing], feet: bool
) -> Iterator[tuple[Lane, tuple[Port, ...]]]:
    """Build the lanes of a street, with their ends at crossings.

    Args:
        street: the street.
        crossings: all crossings of the scene.
        feet: whether the street has pavements with walking lanes.
    """
    for number, (low, high) in enumerate(_split_street(street, crossings)):
        name = f"{street.name}.{number}"
        tracks = street.section.tracks
        for track in tracks:
            yield _build_lane(street, name, track, tracks, low, high)
        if feet:
            offset = street.section.half_m + _WALK_SHARE * street.section.pavement_m
            width = 0.6 * street.section.pavement_m
            for side in (1, -1):
                for way in (1, -1):
                    track = LaneStrip(f"walk{'+' if way > 0 else '-'}{'l' if side > 0 else 'r'}", "walk", side * offset,
                                  width, way, WALK_MPS)  # fmt: skip
                    yield _build_lane(street, name, track, (), low, high)


def _split_street(street: CrossedStreet, crossings: Sequence[Crossing]) -> list[tuple[_Limit, _Limit]]:
    """Split a street into the stretches between its ends and crossings."""
    ends: list[_Limit] = []
    starts: list[_Limit] = []
    for crossing in crossings:
        for number, (arm, approach) in enumerate(zip(crossing.arms, find_approaches(crossing))):
            if arm.street is street:
                limit = _Limit(arm.station(approach.begin_m), crossing.name, number, approach)
                (starts if arm.way > 0 else ends).append(limit)
    starts.sort(key=lambda limit: limit.station_m)
    ends.sort(key=lambda limit: limit.station_m)
    first, last = _Limit(street.line.first_m), _Limit(street.line.last_m)
    if not starts or (ends and ends[0].station_m <= starts[0].station_m):
        starts.insert(0, first)
    if len(ends) < len(starts):
        ends.append(last)
    return list(zip(starts, ends))


def _build_lane(
    street: CrossedStreet, name: str, track: LaneStrip, beside: Sequence[LaneStrip], low: _Limit, high: _Limit
) -> tuple[Lane, tuple[Port, ...]]:
    """Build one lane of a stretch, and its ports."""
    begin, end = (_lane_end_m(limit, track, sign) for limit, sign in ((low, 1), (high, -1)))
    if track.use == "park" and end - begin < _LEAST_M:
        end = begin + _LEAST_M
    line = _sample_line(street, begin, end, track.offset_m)[:: track.way]
    lane_id = f"{name}.{track.name}"
    ports = []
    for limit, station, arrives in ((low, begin, track.way < 0), (high, end, track.way > 0)):
        if limit.approach is not None and track.use != "park":
            heading = float(street.line.heading(station)) + (0.0 if track.way > 0 else math.pi)
            place = line[-1] if arrives else line[0]
            left = (track.offset_m > 0.0) == (limit.approach.arm.way > 0)
            ports.append(Port(lane_id, place, heading, limit.crossing, limit.arm, arrives, left))
    goal = high if track.way > 0 else low
    stop = None
    if goal.approach is not None and goal.approach.stop_m is not None and track.use in ("drive", "cycle"):
        length = float(arrays.hypot(*np.diff(line, axis=0).T).sum())
        stop = length - (goal.approach.stop_m - goal.approach.begin_m)
    left_id, right_id = (_neighbour_id(name, track, beside, side) for side in (1, -1))
    lane = Lane(
        lane_id, track.use, line, track.width_m, track.speed_mps, left=left_id, right=right_id,
        stop_m=None if stop is None else max(stop, 0.0),
    )  # fmt: skip
    return lane, tuple(ports)


def _sample_line(street: CrossedStreet, begin: float, end: float, offset_m: float) -> Float64:
    """A line (N, 2) at an offset from the street's middle, in steps of at most ``_STEP_M`` along it."""
    longest = _STEP_M
    count = 0
    while longest > 0.99 * _STEP_M:
        count = max(count + 1, math.ceil((end - begin) / _STEP_M), math.ceil(count * longest / _STEP_M))
        line = street.line.at(np.linspace(begin, end, count + 1), offset_m)
        longest = float(arrays.hypot(*np.diff(line, axis=0).T).max())
    return line


def _lane_end_m(limit: _Limit, track: LaneStrip, inwards: int) -> float:
    """The station at which a lane ends: parking keeps clear of crossings, walking continues up to the zebra."""
    approach = limit.approach
    if approach is None:
        return limit.station_m
    if track.use == "park":
        return approach.arm.station(approach.end_m) + inwards * _PARK_CLEAR_M
    if track.use == "walk":
        return approach.arm.station(pavement_begin_m(approach))
    return limit.station_m


def pavement_begin_m(approach: Approach) -> float:
    """Return the distance from the crossing's centre at which an arm's pavements begin: at the middle of any zebra."""
    return approach.begin_m + 0.5 if approach.zebra_m is None else 0.5 * sum(approach.zebra_m)


def _neighbour_id(name: str, track: LaneStrip, beside: Sequence[LaneStrip], side: int) -> str | None:
    """Id of the lane to change to, on the left (side 1) or right (side -1) of the driver; None if there is none."""
    if track.use != "drive":
        return None
    for other in beside:
        gap = side * track.way * (other.offset_m - track.offset_m)
        if other.use == "drive" and other.way == track.way and 0.0 < gap < _BESIDE_M:
            return f"{name}.{other.name}"
    return None
