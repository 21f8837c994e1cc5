"""The road network as traffic sees it: lanes, what follows them, where one stops."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from mirror.arrays import Float64

Use = Literal["drive", "turn", "park", "cycle", "walk", "cross"]
"""What a lane is for: driving; turning or going straight on within a crossing; parking; cycling; walking on the
pavement; crossing a carriageway on foot."""


@dataclass(frozen=True)
class Lane:
    """One lane, one way.

    Attributes:
        lane_id: its id.
        use: what it is for.
        line: (N, 3) its middle on the ground, in driving direction, world metres; steps of 1 m at most.
        width_m: of the lane.
        speed_mps: allowed.
        successors: lanes that go on where it ends.
        left: the lane beside it in the same direction that one may change to, or None.
        right: the same to the right.
        stop_m: length along the line at which one waits, or None.
        signal: number of the signal group that it waits for, or None.
        yields_to: lanes whose traffic goes first.
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
        """(N,) lengths along the line on the ground plane, at its points."""
        return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.line[:, :2], axis=0).T))])

    @property
    def length_m(self) -> float:
        """Of the line on the ground plane."""
        return float(self.along_m[-1])


@dataclass(frozen=True)
class Network:
    """All lanes of a scene, and its signals.

    Attributes:
        lanes: by id.
        green_s: (groups, 2) start and end of each signal group's green within the cycle; amber is the 3 s after it.
        cycle_s: length of the signals' cycle.
    """

    lanes: Mapping[str, Lane]
    green_s: Float64
    cycle_s: float
