"""Assigns marking layouts to stretches of street: between crossings, before crossings and in crossings."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64, Records
from mirror.portable import scalars
from mirror.synth.model import Material
from mirror.synth.roads.crossing import Arm, CrossedStreet, Crossing
from mirror.synth.roads.ground import Stretch
from mirror.synth.roads.markings import Mark, dashed_line, pack_layouts, stop_line, yield_line, zebra_marks
from mirror.synth.roads.relief import Dip
from mirror.synth.roads.section import MOTORWAY_EDGE_M, SLIP_EDGE_M, SLIP_ROAD

_ZEBRA_M: Final = (0.5, 3.5)
_STOP_M: Final = (4.6, 5.05)
_YIELD_M: Final = (0.3, 0.75)
_STRICT_M: Final = 18.0
_RAMP_M: Final = 0.9
_PIECE_M: Final = 6.0
_PIECE_RAD: Final = 0.045
_LEAST_PIECE_M: Final = 1.5
_SAME_M: Final = 0.3
_SLIP_LINE: Final = dashed_line(-MOTORWAY_EDGE_M, 0.15, 12.0, 6.0)


@dataclass(frozen=True)
class Approach:
    """Distances of markings on an arm before a crossing, in metres from the crossing's centre.

    Attributes:
        arm: the arm.
        begin_m: end of the crossing's area.
        stop_m: stop line for arriving traffic; None if it need not stop.
        zebra_m: beginning and end of the zebra crossing; None if there is none.
        end_m: distance from which on the street has its usual markings.
    """

    arm: Arm
    begin_m: float
    stop_m: float | None
    zebra_m: tuple[float, float] | None
    end_m: float


def find_approaches(crossing: Crossing) -> tuple[Approach, ...]:
    """Return the approaches of a crossing, in the order of its arms."""
    approach_list = []
    for arm, reach in zip(crossing.arms, crossing.reach_m):
        waits = (crossing.control == "signal" or arm.minor) and arm.street.section.material == Material.ASPHALT
        stop = reach + (_STOP_M if arm.zebra else _YIELD_M)[1] if waits or arm.zebra else None
        walk = (reach + _ZEBRA_M[0], reach + _ZEBRA_M[1]) if arm.zebra else None
        approach_list.append(Approach(arm, reach, stop, walk, reach if stop is None else stop + 0.15))
    return tuple(approach_list)


@dataclass(frozen=True)
class Layouts:
    """All marking layouts of a scene.

    Attributes:
        table: (L, MOST_MARKS) MARK; row 0 is empty.
        stretches: layout index of each stretch of street; later stretches override earlier ones.
        dips: stretches with dropped kerbs.
        stations: for each street, the stations at which its pieces end.
    """

    table: Records
    stretches: tuple[Stretch, ...]
    dips: tuple[Dip, ...]
    stations: tuple[Float64, ...]


def build_layouts(streets: Sequence[CrossedStreet], crossings: Sequence[Crossing]) -> Layouts:
    """Assign markings to the streets, and divide the streets into pieces."""
    rows: list[Sequence[Mark]] = [()]
    stretches: list[Stretch] = []
    dips: list[Dip] = []
    stations = []
    for number, street in enumerate(streets):
        section, line = street.section, street.line
        paved = section.material == Material.ASPHALT
        cuts = [line.first_m, line.last_m]
        if paved:
            rows += [(*section.marks, *section.middle), (*section.marks, *section.strict)]
            stretches.append(Stretch(number, line.first_m, line.last_m, len(rows) - 2))
        strict = len(rows) - 1
        for crossing in crossings:
            if crossing.control == "joint":
                beside = _merging_stations(street, crossing)
                if beside is not None:
                    rows.append((*section.marks, *section.middle[:1], _SLIP_LINE))
                    stretches.append(_make_stretch(number, *beside, len(rows) - 1))
                    cuts += beside
                continue
            for approach in find_approaches(crossing):
                arm = approach.arm
                if arm.street is not street:
                    continue
                begin, end = arm.station(approach.begin_m), arm.station(approach.end_m)
                far = arm.station(approach.end_m + _STRICT_M)
                cuts += [arm.station_m, begin, end, far]
                if paved:
                    stretches.append(_make_stretch(number, end, far, strict))
                    if end != begin:
                        rows.append(_approach_marks(approach, crossing.control == "signal"))
                        stretches.append(_make_stretch(number, begin, end, len(rows) - 1))
                within = 0
                if paved and crossing.control == "priority" and not arm.minor:
                    rows.append(_priority_marks(crossing, street))
                    within = len(rows) - 1
                stretches.append(_make_stretch(number, arm.station_m, begin, within))
                if approach.zebra_m is not None:
                    low, high = sorted(arm.station(out) for out in approach.zebra_m)
                    dips.append(Dip(number, low, high))
                    cuts += [low - _RAMP_M, low, high, high + _RAMP_M]
        stations.append(_piece_stations(street, np.array(cuts)))
    return Layouts(pack_layouts(rows), tuple(stretches), tuple(dips), tuple(stations))


def _merging_stations(street: CrossedStreet, crossing: Crossing) -> tuple[float, float] | None:
    """Stations between which traffic may cross a motorway's right edge line to or from a slip road, or None."""
    slip = next((arm for arm in crossing.arms if arm.street.section is SLIP_ROAD), None)
    main = next((arm for arm in crossing.arms if arm.street is street), None)
    if slip is None or main is None or slip.street is street:
        return None
    # The roads separate where the slip road's left edge leaves the motorway's edge line.
    places = slip.street.line.at(slip.station_m + slip.way * np.arange(0.0, 250.0), SLIP_EDGE_M)
    station, offset = street.line.locate(places)
    parted = int(np.argmax(np.abs(offset) > MOTORWAY_EDGE_M))
    return main.station_m, float(station[parted])


def _make_stretch(street: int, one_m: float, other_m: float, layout: int) -> Stretch:
    return Stretch(street, min(one_m, other_m), max(one_m, other_m), layout)


def _priority_marks(crossing: Crossing, street: CrossedStreet) -> tuple[Mark, ...]:
    """Marks of the priority street inside a crossing: wear, middle line, edge lines where no street joins."""
    heading = next(arm.heading_rad for arm in crossing.arms if arm.street is street and arm.way > 0)
    comes_in = {scalars.sin(arm.heading_rad - heading) > 0.0 for arm in crossing.arms if arm.street is not street}
    section = street.section
    traces = [mark for mark in section.marks if mark.soft_m > 0.0]
    edges = [mark for mark in section.marks if mark.strength == 1.0 and mark.u_stripes[0] == 0.0]
    return (*traces, *section.middle, *(mark for mark in edges if (sum(mark.v_m) > 0.0) not in comes_in))


def _approach_marks(approach: Approach, signal: bool) -> tuple[Mark, ...]:
    """The marks between a crossing and the stretch with the street's usual markings."""
    arm, section = approach.arm, approach.arm.street.section
    begin, end = sorted((arm.station(approach.begin_m), arm.station(approach.end_m)))
    marks: list[Mark] = []
    stop = approach.stop_m
    if approach.zebra_m is not None:
        low, high = sorted(arm.station(out) for out in approach.zebra_m)
        marks.append(zebra_marks((low, high), section.half_m))
    if stop is not None:
        # Arriving traffic keeps right: it is on the left, seen outwards.
        coming = [track for track in section.tracks if track.way == -arm.way and track.use in ("drive", "cycle")]
        sides = [track.offset_m + side * 0.5 * track.width_m for track in coming for side in (-1, 1)]
        broken = not signal and approach.zebra_m is None
        near, far = sorted((arm.station(stop - 0.45), arm.station(stop)))
        bar = yield_line if broken else stop_line
        marks.append(bar((near, far), (min(sides), max(sides))))
    if approach.zebra_m is not None:
        edge = sorted((arm.station(approach.zebra_m[1]), end if arm.way > 0 else begin))
        marks += [_cut_mark(mark, (edge[0], edge[1])) for mark in section.strict]
    else:
        marks += list(section.strict)
    return tuple(marks)


def _cut_mark(mark: Mark, u_m: tuple[float, float]) -> Mark:
    return Mark(u_m, mark.v_m, mark.u_stripes, mark.v_stripes, mark.slant, mark.colour, mark.strength, mark.worn)


def _piece_stations(street: CrossedStreet, cuts: Float64) -> Float64:
    """Stations at which a street's pieces end: at all cuts, and in between at steps that shrink with the curvature."""
    line = street.line
    cuts = np.unique(np.clip(cuts, line.first_m, line.last_m))
    boundaries = [cuts[0]]
    for cut in cuts[1:]:
        if cut - boundaries[-1] > _SAME_M:
            boundaries.append(cut)
    boundaries[-1] = line.last_m
    bends = np.abs(np.gradient(line.headings, line.stations))
    stations = [np.array([boundaries[0]])]
    for low, high in itertools.pairwise(boundaries):
        on = (line.stations >= low) & (line.stations <= high)
        most = float(bends[on].max()) if on.any() else 0.0
        step = min(_PIECE_M, max(_PIECE_RAD / max(most, 1e-9), _LEAST_PIECE_M))
        stations.append(np.linspace(low, high, max(int(np.ceil((high - low) / step)), 1) + 1)[1:])
    return np.concatenate(stations)
