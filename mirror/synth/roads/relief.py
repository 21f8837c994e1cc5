"""Heights of the land, of the carriageways' crowns, and of the kerbs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays, scalars
from mirror.synth.roads.crossing import CrossedStreet, Crossing

_FADE_M: Final = 12.0
_BESIDE_M: Final = 14.0
_DROPPED_M: Final = 0.02
_RAMP_M: Final = 0.9
_RAMP_BEHIND_M: Final = 1.6


@dataclass(frozen=True)
class Land:
    """A smooth surface: a tilted plane with waves; its height at (0, 0) is 0.

    Attributes:
        slope: (2,) gradient of the plane along x and y.
        waves: (W, 4) wave number along x and along y (radians a metre), phase (radians), amplitude (metres).
    """

    slope: Float64
    waves: Float64

    def height_m(self, points: Float64) -> Float64:
        """Return the heights (N,) at points (N, 2)."""
        return arrays.matmul(points, self.slope) + self._waves(points) - self._waves(np.zeros((1, 2)))

    def _waves(self, points: Float64) -> Float64:
        return arrays.matmul(
            arrays.sin(arrays.matmul(points, self.waves[:, :2].T) + self.waves[:, 2]), self.waves[:, 3]
        )


def draw_land(rng: np.random.Generator, slope: float, steepest: float) -> Land:
    """Draw a random land surface.

    Args:
        rng: random generator.
        slope: slope of the plane.
        steepest: upper bound of the slope of all waves together.
    """
    bearing = rng.uniform(0.0, 2.0 * math.pi, 6)
    length = np.array([760.0, 540.0, 390.0, 290.0, 210.0, 160.0]) * rng.uniform(0.9, 1.1, 6)
    number = 2.0 * math.pi / length
    share = np.array([0.30, 0.24, 0.18, 0.14, 0.08, 0.06])
    waves = np.c_[
        number * arrays.cos(bearing), number * arrays.sin(bearing), rng.uniform(0.0, 6.3, 6), steepest * share / number
    ]
    tilt = rng.uniform(0.0, 2.0 * math.pi)
    return Land(slope * np.array([scalars.cos(tilt), scalars.sin(tilt)]), waves)


@dataclass(frozen=True)
class Dip:
    """A stretch of a street, between two stations, where the kerbs are dropped."""

    street: int
    low_m: float
    high_m: float


@dataclass(frozen=True)
class Relief:
    """Heights of the carriageways and of the surfaces beside them.

    Attributes:
        land: the surface below the streets.
        streets: the streets.
        level_at: for each street, stretches (K, 2) of stations without a crown: its crossings.
        kerb_m: height of the kerbs.
        dips: stretches with dropped kerbs.
    """

    land: Land
    streets: tuple[CrossedStreet, ...]
    level_at: tuple[Float64, ...]
    kerb_m: float
    dips: tuple[Dip, ...]

    def heights_m(self, points: Float64, places: Sequence[tuple[Float64, Float64]]) -> tuple[Float64, Float64]:
        """Return the heights (N,) of the carriageway, and heights (N,) of the surface that is one kerb higher.

        Args:
            points: (N, 2) positions, metres.
            places: for each street, stations (N,) and offsets (N,) of the points.
        """
        low = self.land.height_m(points)
        raised = np.ones(len(points))
        for number, street in enumerate(self.streets):
            station, offset = places[number]
            station = np.clip(station, street.line.first_m, street.line.last_m)
            low = low - self._drop(number, station, np.abs(offset))
            for dip in self.dips:
                if dip.street == number:
                    middle, half = 0.5 * (dip.low_m + dip.high_m), 0.5 * (dip.high_m - dip.low_m)
                    along = np.clip(1.0 - (np.abs(station - middle) - half) / _RAMP_M, 0.0, 1.0)
                    behind = np.clip(1.0 - (np.abs(offset) - street.section.half_m) / _RAMP_BEHIND_M, 0.0, 1.0)
                    raised *= 1.0 - along * behind
        least = min(_DROPPED_M, self.kerb_m)
        return low, low + least + (self.kerb_m - least) * raised

    def _drop(self, number: int, station: Float64, aside: Float64) -> Float64:
        section = self.streets[number].section
        wide = section.half_m - section.median_m
        across = np.clip(aside - section.median_m, 0.0, wide) * section.crossfall
        beyond = aside - section.half_m - section.pavement_m
        beside = _smoothstep(1.0 - beyond / _BESIDE_M)
        crown = np.ones_like(station)
        for low, high in self.level_at[number]:
            gap = np.maximum(low - station, station - high)
            crown = np.minimum(crown, _smoothstep(gap / _FADE_M))
        return across * beside * crown


def _smoothstep(x: Float64) -> Float64:
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def find_level_stretches(street: CrossedStreet, crossings: Sequence[Crossing]) -> Float64:
    """Return the stretches (K, 2) of a street's stations that lie inside crossings and are level."""
    stretches = []
    for crossing in crossings:
        mine = [
            arm.station(reach)
            for arm, reach in zip(crossing.arms, crossing.reach_m)
            if arm.street is street and crossing.control != "joint"
        ]
        if mine:
            middle = next(arm.station_m for arm in crossing.arms if arm.street is street)
            stretches.append((min(*mine, middle), max(*mine, middle)))
    return np.array(stretches).reshape(-1, 2)
