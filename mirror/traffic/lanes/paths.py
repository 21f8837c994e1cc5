"""Paths through the network: sequences of lanes from an entry to an exit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays
from mirror.traffic.lanes.network import Lane, Network, Use

TURN_RAD: Final = math.radians(40.0)
_LONGEST: Final = 40


@dataclass(frozen=True)
class Path:
    """A sequence of connected lanes.

    Attributes:
        lanes: the lanes, in order.
    """

    lanes: tuple[Lane, ...]

    @property
    def lane_ids(self) -> tuple[str, ...]:
        """The ids of the lanes."""
        return tuple(lane.lane_id for lane in self.lanes)

    @property
    def line(self) -> Float64:
        """(N, 2) points of all lanes, metres."""
        return np.vstack([lane.line[:, :2] for lane in self.lanes])

    @property
    def turns(self) -> tuple[float, ...]:
        """Angles of the turns at crossings, positive to the left, radians."""
        turns = [turn_rad(lane) for lane in self.lanes if lane.use == "turn"]
        return tuple(angle for angle in turns if abs(angle) > TURN_RAD)

    def inside_m(self, radius_m: float) -> float:
        """Return the length within a circle around the origin."""
        line = self.line
        step = arrays.hypot(*np.diff(line, axis=0).T)
        middle = 0.5 * (line[1:] + line[:-1])
        return float(step[arrays.hypot(*middle.T) < radius_m].sum())

    @property
    def closest_m(self) -> float:
        """Smallest distance from the origin."""
        return float(arrays.hypot(*self.line.T).min())

    @property
    def chord(self) -> Float64:
        """(2,) unit vector from its beginning to its end."""
        line = self.line
        step = line[-1] - line[0]
        return step / arrays.hypot(*step)


def turn_rad(lane: Lane) -> float:
    """Return the change of direction along a lane, positive to the left, radians."""
    step = np.diff(lane.line[:, :2], axis=0)
    step = step[arrays.hypot(*step.T) > 1e-6]
    heading = np.unwrap(arrays.arctan2(step[:, 1], step[:, 0]))
    return float(heading[-1] - heading[0])


def select_lanes(network: Network, *uses: Use) -> dict[str, Lane]:
    """Return the lanes with given uses, by id."""
    return {lane_id: lane for lane_id, lane in network.lanes.items() if lane.use in uses}


def source_lanes(lanes: dict[str, Lane]) -> list[Lane]:
    """Return the entry lanes of the network, ordered by id: street lanes without a predecessor."""
    reached = {name for lane in lanes.values() for name in lane.successors}
    return [lanes[name] for name in sorted(lanes) if name not in reached and lanes[name].use not in ("turn", "cross")]


def iterate_paths(lanes: dict[str, Lane], start: Lane) -> Iterator[Path]:
    """Iterate over all paths from a lane to the exits of the network; no path uses a lane twice."""

    def onward(so_far: tuple[Lane, ...]) -> Iterator[Path]:
        following = [
            name for name in so_far[-1].successors if name in lanes and all(lanes[name] is not lane for lane in so_far)
        ]
        if not following or len(so_far) >= _LONGEST:
            yield Path(so_far)
        for name in following:
            yield from onward((*so_far, lanes[name]))

    return onward((start,))


def draw_path(
    lanes: dict[str, Lane], start: Lane, rng: np.random.Generator, straight: float, least_bend_m: float = 0.0
) -> Path:
    """Draw a random path.

    Args:
        lanes: lanes that may be used.
        start: the first lane.
        rng: random numbers.
        straight: weight of going straight on, relative to a turn.
        least_bend_m: smallest turning radius; tighter turns are used only if there is no other lane.
    """
    path = [start]
    while len(path) < _LONGEST:
        following = [
            lanes[name]
            for name in path[-1].successors
            if name in lanes and all(lanes[name] is not lane for lane in path)
        ]
        wide = [lane for lane in following if _bend_radius_m(lane) >= least_bend_m]
        following = wide or following
        if not following:
            break
        weights = np.array([straight if abs(turn_rad(lane)) < TURN_RAD else 1.0 for lane in following])
        path.append(following[int(rng.choice(len(following), p=weights / weights.sum()))])
    return Path(tuple(path))


def beside_m(lane: Lane, point: Sequence[float] | Float64) -> float:
    """Return the length along a lane at which the lane is closest to a point."""
    return float(lane.along_m[np.argmin(np.sum((lane.line[:, :2] - np.asarray(point)[:2]) ** 2, axis=1))])


def _bend_radius_m(lane: Lane) -> float:
    return lane.length_m / max(abs(turn_rad(lane)), 1e-3)
