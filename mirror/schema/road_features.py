"""The features of a road map: lanes, parts of the drivable area, crossings and signals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal, get_args

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError

LaneKind = Literal["drive", "turn", "park", "cycle", "walk", "cross"]
"""Purpose of a lane: driving; driving through a junction; parking; cycling; walking; crossing a carriageway on foot."""
DRIVING: Final[frozenset[LaneKind]] = frozenset({"drive", "turn"})
"""Kinds of lanes for motor vehicles in motion."""
SignalState = Literal["green", "amber", "red", "red_amber"]
SIGNAL_STATES: Final[tuple[SignalState, ...]] = get_args(SignalState)


@dataclass(frozen=True, eq=False)
class MapLane:
    """One lane with one direction of travel.

    Attributes:
        lane_id: id of the lane.
        kind: purpose of the lane.
        center_m: (P, 3) middle line on the ground in driving direction.
        width_m: (P,) width at the points of the middle line.
        speed_limit_mps: speed limit; None: unknown.
        successors: ids of the lanes that begin where this one ends.
        predecessors: ids of the lanes that end where this one begins.
        left: id of the left neighbour with the same direction, or None.
        right: id of the right neighbour with the same direction, or None.
        stop_m: distance of the stop line from the beginning of the lane, or None.
        signal: id of the signal that controls the lane's end, or None.
        yields_to: ids of the lanes that have the right of way over this one.

    Raises:
        UsageError: the line has fewer than two points, a coordinate or width is not finite, or a width is not positive.
    """

    lane_id: str
    kind: LaneKind
    center_m: Float64
    width_m: Float64
    speed_limit_mps: float | None = None
    successors: tuple[str, ...] = ()
    predecessors: tuple[str, ...] = ()
    left: str | None = None
    right: str | None = None
    stop_m: float | None = None
    signal: str | None = None
    yields_to: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        place = f"lane {self.lane_id!r}"
        if self.kind not in get_args(LaneKind):
            raise UsageError(f"kind {self.kind!r}", place=place, expected=f"one of {', '.join(get_args(LaneKind))}")
        if self.center_m.ndim != 2 or self.center_m.shape[1:] != (3,) or len(self.center_m) < 2:
            raise UsageError(
                f"a middle line of shape {self.center_m.shape}", place=place, expected="(P, 3), two points or more"
            )
        if self.width_m.shape != (len(self.center_m),):
            raise UsageError(f"widths of shape {self.width_m.shape}", place=place, expected="one width a point")
        if not np.isfinite(self.center_m).all() or not (np.isfinite(self.width_m) & (self.width_m > 0.0)).all():
            raise UsageError("a coordinate is not finite, or a width is not positive", place=place)
        if not self.length_m > 0.0:
            raise UsageError("a middle line of length 0", place=place)

    @cached_property
    def along_m(self) -> Float64:
        """(P,) distances along the middle line on the ground plane, at its points."""
        steps = np.diff(self.center_m[:, :2], axis=0)
        return np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])

    @property
    def length_m(self) -> float:
        """Length of the middle line on the ground plane."""
        return float(self.along_m[-1])

    @cached_property
    def outline_m(self) -> Float64:
        """(2 P, 2) outline: the right edge in driving direction, then the left edge back."""
        points = self.center_m[:, :2]
        ahead = np.gradient(points, axis=0)
        ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-12)
        left = 0.5 * self.width_m[:, None] * np.column_stack([-ahead[:, 1], ahead[:, 0]])
        return np.concatenate([points - left, (points + left)[::-1]])


@dataclass(frozen=True, eq=False)
class MapArea:
    """A part of the drivable area; parts do not overlap.

    Attributes:
        area_id: id of the part.
        rings: rings (K, 2) without a repeated last point: the outline, then its holes.

    Raises:
        UsageError: there is no ring, or a ring has fewer than three points or a coordinate that is not finite.
    """

    area_id: str
    rings: tuple[Float64, ...]

    def __post_init__(self) -> None:
        if not self.rings:
            raise UsageError("no outline", place=f"area {self.area_id!r}")
        for ring in self.rings:
            _require_ring(ring, f"area {self.area_id!r}")


@dataclass(frozen=True, eq=False)
class MapCrossing:
    """A place where pedestrians cross a carriageway.

    Attributes:
        crossing_id: id of the crossing.
        outline_m: (K, 2) outline, without a repeated last point.

    Raises:
        UsageError: the outline has fewer than three points, or a coordinate that is not finite.
    """

    crossing_id: str
    outline_m: Float64

    def __post_init__(self) -> None:
        _require_ring(self.outline_m, f"crossing {self.crossing_id!r}")


@dataclass(frozen=True)
class MapSignal:
    """A signal that repeats its phases.

    Attributes:
        signal_id: id of the signal.
        phases: states and their durations in seconds, in the order of the cycle; empty: the phases are not known.
        offset_s: time of the signals' clock at which the first phase begins.

    Raises:
        UsageError: a state is unknown, or a duration is not positive.
    """

    signal_id: str
    phases: tuple[tuple[SignalState, float], ...] = ()
    offset_s: float = 0.0

    def __post_init__(self) -> None:
        for state, duration_s in self.phases:
            if state not in SIGNAL_STATES or not 0.0 < duration_s < np.inf:
                raise UsageError(
                    f"phase {state!r} of {duration_s} s",
                    place=f"signal {self.signal_id!r}",
                    expected=f"one of {', '.join(SIGNAL_STATES)}, with a positive duration",
                )

    @property
    def cycle_s(self) -> float:
        """Duration of the cycle."""
        return sum(duration_s for _, duration_s in self.phases)

    def state_at(self, clock_s: float) -> SignalState | None:
        """Return the state at a time of the signals' clock; None if the phases are not known."""
        if not self.phases:
            return None
        since = (clock_s - self.offset_s) % self.cycle_s
        for state, duration_s in self.phases:
            if since < duration_s:
                return state
            since -= duration_s
        return self.phases[-1][0]


def _require_ring(ring: Float64, place: str) -> None:
    if ring.ndim != 2 or ring.shape[1:] != (2,) or len(ring) < 3 or not np.isfinite(ring).all():
        raise UsageError(
            f"a ring of shape {ring.shape}", place=place, expected="(K, 2) finite coordinates of three points or more"
        )
