"""The participants of the traffic, and the conversion of their ways and meetings to arrays for the simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from mirror.arrays import Float64
from mirror.traffic.following.acceleration import Users, Ways
from mirror.traffic.following.simulation import TICK_S, simulate
from mirror.traffic.following.yielding import Meetings, State
from mirror.traffic.following.zones import Zone, find_zones
from mirror.traffic.lanes.network import Network
from mirror.traffic.lanes.ways import Way
from mirror.traffic.placement.trace import Aside, Chassis, Schedule

Kind = Literal["car", "van", "truck", "bus", "motorcycle", "cyclist", "pedestrian"]
KINDS: Final[tuple[Kind, ...]] = ("car", "van", "truck", "bus", "motorcycle", "cyclist", "pedestrian")

_NEVER: Final = 1e9
_ROOM_M: Final = 0.35
_WIDTHS: Final[dict[Kind, float]] = {
    "car": 2.1, "van": 2.1, "truck": 2.7, "bus": 2.7, "motorcycle": 0.9, "cyclist": 0.9, "pedestrian": 0.6,
}  # fmt: skip


@dataclass(frozen=True)
class Manner:
    """The driving style of a participant.

    Attributes:
        eager: desired speed as a share of the speed that the way allows.
        fastest_mps: greatest speed.
        pick_up_mps2: greatest acceleration.
        brake_mps2: comfortable deceleration.
        headway_s: time gap to the participant ahead.
        phase: phase of the small variations of speed.
    """

    eager: float
    fastest_mps: float
    pick_up_mps2: float
    brake_mps2: float
    headway_s: float
    phase: float = 0.0


@dataclass(frozen=True, eq=False)
class Participant:
    """One participant of the traffic.

    Attributes:
        kind: kind of road user.
        number: index of its body in the population of that kind.
        way: way that it follows; participants may share a way.
        chassis: dimensions.
        manner: driving style.
        aside: lateral position in the lane.
        enter_s: desired time of entry, seconds after the first tick.
        enter_m: length of its front end along the way at its entry.
        end_m: length at which it leaves; default: the end of the way.
        pause_m: length at which it makes a pause.
        pause_s: duration of the pause.
    """

    kind: Kind
    number: int
    way: Way
    chassis: Chassis
    manner: Manner
    aside: Aside
    enter_s: float = 0.0
    enter_m: float = 0.0
    end_m: float | None = None
    pause_m: float = _NEVER
    pause_s: float = 0.0


def simulate_participants(
    network: Network,
    participants: Sequence[Participant],
    clock_s: float,
    longest_s: float,
    *,
    first_goes_first: bool = False,
) -> list[Schedule | None]:
    """Simulate all participants until the first of them has left.

    Args:
        network: road network with its signals.
        participants: the participants; the recording vehicle is the first.
        clock_s: time of the signal cycle at the first tick.
        longest_s: longest simulated time.
        first_goes_first: True: the first participant has right of way everywhere and obeys signals only.

    Returns:
        The schedule of each participant, with times from the first tick; None for one that never had room to enter.
    """
    ways: list[Way] = []
    for participant in participants:
        if not any(participant.way is way for way in ways):
            ways.append(participant.way)
    number = {id(way): place for place, way in enumerate(ways)}
    road_users = _make_road_users(participants, number)
    meetings = _find_meetings(participants, ways, number)
    if first_goes_first:
        ego_column = np.argmax(meetings.road_users == 0, axis=1)
        meetings = meetings._replace(major=np.where((meetings.road_users == 0).any(axis=1), ego_column, meetings.major))
    green = np.ascontiguousarray(network.green_s, np.float64).reshape(-1, 2)
    ticks = int(longest_s / TICK_S)
    now = State(*np.zeros((len(State._fields), len(participants))))
    lengths, speeds = simulate(
        _pack_ways(ways), road_users, meetings, now, green, network.cycle_s, clock_s, ticks, first_goes_first
    )
    schedules: list[Schedule | None] = []
    for place in range(len(participants)):
        there = np.flatnonzero(np.isfinite(lengths[:, place]))
        if len(there) < 2:
            schedules.append(None)
            continue
        span = slice(there[0], there[-1] + 1)
        schedules.append(
            # The state of a tick is that at its end.
            Schedule((there[0] + 1) * TICK_S, TICK_S, lengths[span, place].copy(), speeds[span, place].copy())
        )
    return schedules


def _pack_ways(ways: Sequence[Way]) -> Ways:
    halts = [halt for way in ways for halt in way.halts]
    return Ways(
        np.cumsum([0, *(len(way.points) for way in ways)], dtype=np.int64),
        np.concatenate([way.pace_mps for way in ways]),
        np.cumsum([0, *(len(way.halts) for way in ways)], dtype=np.int64),
        np.array([halt.at_m for halt in halts], np.float64),
        np.array([halt.clear_m for halt in halts], np.float64),
        np.array([-1 if halt.group is None else halt.group for halt in halts], np.int64),
        np.array([halt.on_foot for halt in halts], np.uint8),
    )


def _make_road_users(participants: Sequence[Participant], number: dict[int, int]) -> Users:
    rows = [
        (
            participant.chassis.length_m,
            participant.enter_s,
            participant.enter_m,
            participant.way.length_m if participant.end_m is None else participant.end_m,
            participant.manner.eager,
            participant.manner.fastest_mps,
            participant.manner.pick_up_mps2,
            participant.manner.brake_mps2,
            participant.manner.headway_s,
            participant.manner.phase,
            participant.pause_m,
            participant.pause_s,
        )
        for participant in participants
    ]
    ways = np.array([number[id(participant.way)] for participant in participants], np.int64)
    return Users(ways, *np.ascontiguousarray(np.array(rows, np.float64).T))


def _find_meetings(participants: Sequence[Participant], ways: Sequence[Way], number: dict[int, int]) -> Meetings:
    """All meetings of two participants; the zones of each pair of ways are computed once."""
    known: dict[tuple[int, int, float], list[int]] = {}
    zones: list[Zone] = []
    pairs: list[tuple[int, int]] = []
    chosen: list[int] = []
    place = [number[id(participant.way)] for participant in participants]
    crosses = [
        participant.kind != "pedestrian" or any(lane.use == "cross" for lane in participant.way.lanes)
        for participant in participants
    ]
    for i, participant in enumerate(participants):
        for j in range(i):
            other = participants[j]
            if participant.kind == "pedestrian" and other.kind == "pedestrian":
                # Pedestrians avoid each other unless they walk in one file.
                if participant.way is not other.way or participant.aside.right_m != other.aside.right_m:
                    continue
            elif not (crosses[i] and crosses[j]):
                continue
            # Few different widths keep the number of zone computations small.
            room = 0.5 * (_WIDTHS[participant.kind] + _WIDTHS[other.kind]) + _ROOM_M
            p, q = (i, j) if place[i] <= place[j] else (j, i)
            key = (place[p], place[q], room)
            if key not in known:
                new = find_zones(ways[key[0]], ways[key[1]], room)
                known[key] = list(range(len(zones), len(zones) + len(new)))
                zones += new
            pairs += [(p, q)] * len(known[key])
            chosen += known[key]
    zone = np.array(chosen, np.int64)
    limits = [limit for one_zone in zones for limit in one_zone.limits]
    counts = np.array([len(limit) for limit in limits], np.int64)
    tables = np.concatenate([[0], np.cumsum(counts)[:-1]]) if limits else counts
    return Meetings(
        np.array(pairs, np.int64).reshape(-1, 2),
        _close_pairs([one_zone.begin_m for one_zone in zones])[zone],
        _close_pairs([one_zone.end_m for one_zone in zones])[zone],
        _close_pairs([one_zone.hold_m for one_zone in zones])[zone],
        tables.astype(np.int64).reshape(-1, 2)[zone],
        counts.reshape(-1, 2)[zone],
        np.array([one_zone.along for one_zone in zones], np.uint8)[zone],
        np.array([one_zone.first for one_zone in zones], np.int64)[zone],
        np.concatenate(limits) if limits else np.zeros(0),
    )


def _close_pairs(values: list[tuple[float, float]]) -> Float64:
    return np.array(values, np.float64).reshape(-1, 2)
