"""The road network for traffic simulation: lanes, their successors and their stop positions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from mirror.arrays import Float64
from mirror.portable import arrays

Use = Literal["drive", "turn", "park", "cycle", "walk", "cross"]
"""Purpose of a lane: driving; turning or going straight through a crossing; parking; cycling; walking on the pavement;
crossing a carriageway on foot."""


@dataclass(frozen=True)
class Lane:
    """One lane with one direction of travel.

    Attributes:
        lane_id: id of the lane.
        use: purpose of the lane.
        line: (N, 3) middle line on the ground in driving direction, world frame, metres; steps of at most 1 m.
        width_m: width of the lane.
        speed_mps: speed limit.
        successors: ids of the lanes that begin where this one ends.
        left: id of the left neighbour in the same direction that traffic may change to, or None.
        right: id of the right neighbour that traffic may change to, or None.
        stop_m: position of the stop line along the lane, or None.
        signal: index of the signal group that controls the lane, or None.
        yields_to: ids of the lanes that have the right of way over this one.
    """

    lane_id: str
    use: Use
    line: Float64
    width_m: float
    speed_mps: float
    successors: tuple[str, ...] = ()
    left: str | None = None
    right: str | None = None
    stop_m: float | None = None
    signal: int | None = None
    yields_to: tuple[str, ...] = ()

    @cached_property
    def along_m(self) -> Float64:
        """Distances (N,) along the line on the ground plane, at its points."""
        return np.concatenate([[0.0], np.cumsum(arrays.hypot(*np.diff(self.line[:, :2], axis=0).T))])

    @property
    def length_m(self) -> float:
        """Length of the line on the ground plane."""
        return float(self.along_m[-1])


@dataclass(frozen=True)
class Network:
    """All lanes and signals of a scene.

    Attributes:
        lanes: the lanes, by id.
        green_s: (groups, 2) start and end of each signal group's green within the cycle; 3 s of amber follow.
        cycle_s: length of the signals' cycle.
    """

    lanes: Mapping[str, Lane]
    green_s: Float64
    cycle_s: float
