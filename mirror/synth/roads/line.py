"""Middle lines of streets: smooth curves with continuous curvature."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64
from mirror.portable import arrays

_STEP_M: Final = 0.1
_COARSE: Final = 30
_TOUCHES: Final = 6


@dataclass(frozen=True)
class Bend:
    """A bend whose curvature is a raised cosine; its least radius is ``length_m / (2 |turn_rad|)``.

    Attributes:
        at_m: station of its middle, metres.
        length_m: length of the bend.
        turn_rad: change of heading over the bend, counter-clockwise.
    """

    at_m: float
    length_m: float
    turn_rad: float


@dataclass(frozen=True)
class Line:
    """A smooth line, addressed by stations (metres along it) and offsets (metres to its left).

    Attributes:
        first_m: smallest station.
        last_m: largest station.
        stations: (N,) evenly spaced stations of the table, metres.
        points: (N, 2) positions at the stations, metres.
        headings: (N,) headings at the stations, radians, counter-clockwise from east, without jumps of 2 pi.
    """

    first_m: float
    last_m: float
    stations: Float64
    points: Float64
    headings: Float64

    def heading(self, station_m: npt.ArrayLike) -> Float64:
        """Return the headings (...,) at stations, radians; beyond an end, the heading at that end."""
        return np.asarray(np.interp(np.asarray(station_m, np.float64), self.stations, self.headings))

    def at(self, station_m: npt.ArrayLike, offset_m: npt.ArrayLike = 0.0) -> Float64:
        """Return points (..., 2) at stations and offsets to the left; the line continues straight beyond its ends."""
        station, offset = np.broadcast_arrays(np.asarray(station_m, np.float64), np.asarray(offset_m, np.float64))
        heading = self.heading(station)
        beyond = station - np.clip(station, self.stations[0], self.stations[-1])
        x = np.interp(station, self.stations, self.points[:, 0])
        y = np.interp(station, self.stations, self.points[:, 1])
        cos, sin = arrays.cos(heading), arrays.sin(heading)
        return np.stack([x + beyond * cos - offset * sin, y + beyond * sin + offset * cos], axis=-1)

    def locate(self, points: npt.ArrayLike) -> tuple[Float64, Float64]:
        """Return the stations (N,) and offsets (N,) of points (N, 2), by Newton's method for their perpendiculars.

        The line continues straight beyond its ends.
        """
        where = np.asarray(points, np.float64)
        coarse = self.points[::_COARSE]
        away = np.einsum("ci,ci->c", coarse, coarse)[None] - arrays.matmul(2.0 * where, coarse.T)
        nearest = np.argmin(away, axis=1)
        station = self.stations[::_COARSE][nearest]
        low = np.where(nearest == 0, -np.inf, station - 2.0 * _COARSE * _STEP_M)
        high = np.where(nearest == len(coarse) - 1, np.inf, station + 2.0 * _COARSE * _STEP_M)
        bends = np.gradient(self.headings, self.stations)
        for _ in range(_TOUCHES):
            gap = where - self.at(station)
            heading = self.heading(station)
            cos, sin = arrays.cos(heading), arrays.sin(heading)
            ahead, aside = gap[:, 0] * cos + gap[:, 1] * sin, gap[:, 1] * cos - gap[:, 0] * sin
            stretch = np.maximum(1.0 - np.interp(station, self.stations, bends) * aside, 0.2)
            station = np.clip(station + ahead / stretch, low, high)
        gap, heading = where - self.at(station), self.heading(station)
        return station, gap[:, 1] * arrays.cos(heading) - gap[:, 0] * arrays.sin(heading)

    def until(self, distance_m: float) -> Line:
        """Return the stretch around station 0 that lies within ``distance_m`` of (0, 0)."""
        far = arrays.hypot(*self.points.T) > distance_m
        middle = int(np.argmin(np.abs(self.stations)))
        before, after = np.flatnonzero(far[:middle]), np.flatnonzero(far[middle:])
        first = before[-1] + 1 if len(before) else 0
        last = middle + (after[0] if len(after) else len(far) - middle)
        part = slice(int(first), int(last))
        stations = self.stations[part]
        return Line(float(stations[0]), float(stations[-1]), stations, self.points[part], self.headings[part])


def build_line(
    place: npt.ArrayLike, heading_rad: float, first_m: float, last_m: float, bends: Sequence[Bend] = ()
) -> Line:
    """Build a line with bends.

    Args:
        place: (2,) position of station 0, metres.
        heading_rad: heading at station 0.
        first_m: smallest station, at most 0.
        last_m: largest station, at least 0.
        bends: the bends, in any order.
    """
    before, after = math.ceil(-first_m / _STEP_M), math.ceil(last_m / _STEP_M)
    stations: Float64 = _STEP_M * np.arange(-before, after + 1, dtype=np.float64)
    heading = heading_rad + _heading_change(stations, bends) - _heading_change(np.zeros(1), bends)
    middle = heading_rad + _heading_change(stations[:-1] + 0.5 * _STEP_M, bends) - _heading_change(np.zeros(1), bends)
    points = np.zeros((len(stations), 2))
    for axis, part in enumerate((arrays.cos, arrays.sin)):
        # Simpson's rule over every step.
        step = _STEP_M / 6.0 * (part(heading[:-1]) + 4.0 * part(middle) + part(heading[1:]))
        points[1:, axis] = np.cumsum(step)
    points += np.asarray(place, np.float64) - points[before]
    return Line(float(stations[0]), float(stations[-1]), stations, points, heading)


def _heading_change(stations: Float64, bends: Sequence[Bend]) -> Float64:
    total = np.zeros_like(stations)
    for bend in bends:
        x = np.clip((stations - bend.at_m) / bend.length_m, -0.5, 0.5)
        total += bend.turn_rad * (0.5 + x + arrays.sin(2.0 * math.pi * x) / (2.0 * math.pi))
    return total
