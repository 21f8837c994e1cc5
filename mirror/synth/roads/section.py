"""Cross-sections of streets: lanes and markings from one edge to the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from mirror.synth.model import Material
from mirror.synth.roads.markings import (
    Mark,
    cycle_lane,
    dashed_line,
    oil_stain,
    parking_bays,
    solid_line,
    wheel_tracks,
)
from mirror.traffic.lanes.network import Use


@dataclass(frozen=True)
class LaneStrip:
    """One lane of a cross-section.

    Attributes:
        name: name of the lane, unique within the section.
        use: what the lane is for.
        offset_m: its middle, metres to the left of the street's middle.
        width_m: width of the lane.
        way: 1 if traffic moves along the street's stations, -1 if against them.
        speed_mps: speed limit.
    """

    name: str
    use: Use
    offset_m: float
    width_m: float
    way: int
    speed_mps: float


@dataclass(frozen=True)
class Section:
    """A cross-section that is the same on both sides.

    Attributes:
        half_m: distance from the middle to the outer edge of the carriageway.
        tracks: the lanes.
        marks: all markings except the middle line.
        middle: markings of the middle line where overtaking is allowed.
        strict: markings of the middle line before crossings.
        median_m: distance from the middle to the inner edge of the carriageway; 0: there is only one carriageway.
        crossfall: outward slope of the carriageway, metres per metre.
        pavement_m: width of the pavement, verge or shoulder beside the carriageway.
        material: material of the carriageway.
        colour: reflectance (r, g, b) of the carriageway.
    """

    half_m: float
    tracks: tuple[LaneStrip, ...]
    marks: tuple[Mark, ...] = ()
    middle: tuple[Mark, ...] = ()
    strict: tuple[Mark, ...] = ()
    median_m: float = 0.0
    crossfall: float = 0.025
    pavement_m: float = 3.4
    material: Material = Material.ASPHALT
    colour: tuple[float, float, float] = (0.100, 0.100, 0.104)


def _track_pair(use: Use, offset: float, width: float, speed: float, number: int = 1) -> tuple[LaneStrip, LaneStrip]:
    """One lane on each side; traffic keeps right."""
    return (
        LaneStrip(f"{use}{number}+", use, -offset, width, 1, speed),
        LaneStrip(f"{use}{number}-", use, offset, width, -1, speed),
    )


def _wear_marks(*offsets: float) -> tuple[Mark, ...]:
    """Wheel tracks and oil stains of lanes at offsets on both sides."""
    lanes = [side * offset for offset in offsets for side in (1.0, -1.0)]
    return tuple(mark for lane in lanes for mark in (*wheel_tracks(lane), oil_stain(lane)))


MAIN_STREET: Final = Section(
    5.9,
    (*_track_pair("drive", 1.75, 3.4, 13.9), *_track_pair("park", 4.75, 2.2, 3.0)),
    marks=(*_wear_marks(1.75), *parking_bays(3.6, 5.85), *parking_bays(-3.6, -5.85)),
    middle=(dashed_line(0.0, 0.06, 9.0, 3.0),),
    strict=(solid_line(0.0, 0.06),),
    pavement_m=3.8,
)
CYCLE_STREET: Final = Section(
    5.5,
    (*_track_pair("drive", 1.7, 3.3, 13.9), *_track_pair("cycle", 4.4, 1.8, 7.0)),
    marks=(*_wear_marks(1.7), *cycle_lane(3.5, 5.3), *cycle_lane(-5.3, -3.5)),
    middle=(dashed_line(0.0, 0.06, 9.0, 3.0),),
    strict=(solid_line(0.0, 0.06),),
    pavement_m=3.2,
    colour=(0.088, 0.088, 0.092),
)
SIDE_STREET: Final = Section(
    3.3,
    _track_pair("drive", 1.6, 3.1, 8.3),
    marks=_wear_marks(1.5),
    pavement_m=2.6,
    colour=(0.125, 0.122, 0.118),
)
OUTER_STREET: Final = Section(
    5.0,
    _track_pair("drive", 1.85, 3.5, 13.9),
    marks=(*_wear_marks(1.85), *(solid_line(side * 4.6, 0.06) for side in (1, -1))),
    middle=(dashed_line(0.0, 0.06, 9.0, 3.0),),
    strict=(solid_line(0.0, 0.06),),
    pavement_m=3.0,
    colour=(0.110, 0.110, 0.110),
)
CAMPUS_STREET: Final = Section(
    3.7,
    _track_pair("drive", 1.8, 3.4, 8.3),
    marks=_wear_marks(1.8),
    middle=(dashed_line(0.0, 0.05, 6.0, 2.0),),
    strict=(solid_line(0.0, 0.05),),
    pavement_m=2.8,
    colour=(0.135, 0.133, 0.130),
)
COUNTRY_ROAD: Final = Section(
    3.4,
    _track_pair("drive", 1.65, 3.2, 19.4),
    marks=(*_wear_marks(1.65), *(solid_line(side * 3.1, 0.06) for side in (1, -1))),
    middle=(dashed_line(0.0, 0.06, 12.0, 4.0),),
    strict=(solid_line(0.0, 0.06),),
    pavement_m=1.0,
    colour=(0.115, 0.114, 0.112),
)
FARM_TRACK: Final = Section(
    1.9,
    _track_pair("drive", 0.8, 1.6, 5.6),
    pavement_m=0.6,
    crossfall=0.02,
    material=Material.GRAVEL,
    colour=(0.30, 0.26, 0.20),
)
MOTORWAY_EDGE_M: Final = 13.95
"""Offset of the line between a motorway's lanes and its hard shoulder, metres."""
SLIP_EDGE_M: Final = 2.6
"""Offset of a slip road's edge lines, metres."""
MOTORWAY: Final = Section(
    16.6,
    tuple(
        track for number, offset in enumerate((12.0, 8.25, 4.5), start=1)
        for track in _track_pair("drive", offset, 3.75, 33.0, number)
    ),
    marks=(
        *_wear_marks(12.0, 8.25, 4.5),
        *(dashed_line(side * offset, 0.075, 18.0, 6.0) for offset in (6.375, 10.125) for side in (1, -1)),
        *(solid_line(side * 2.55, 0.075) for side in (1, -1)),
    ),
    middle=tuple(solid_line(side * MOTORWAY_EDGE_M, 0.15) for side in (1, -1)),
    strict=tuple(solid_line(side * MOTORWAY_EDGE_M, 0.15) for side in (1, -1)),
    median_m=2.1,
    pavement_m=2.0,
    colour=(0.120, 0.120, 0.120),
)  # fmt: skip
SLIP_ROAD: Final = Section(
    3.6,
    (LaneStrip("drive1+", "drive", 0.0, 4.0, 1, 16.7),),
    marks=(*wheel_tracks(0.0), *(solid_line(side * SLIP_EDGE_M, 0.1) for side in (1, -1))),
    crossfall=0.0,
    pavement_m=1.5,
    colour=(0.118, 0.118, 0.118),
)
