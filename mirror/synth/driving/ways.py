"""Ways: lanes joined end to end into one smooth line, with the pace that its bends allow and the places to stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int32
from mirror.errors import UsageError
from mirror.synth.street.network import Lane, Network

STEP_M: Final = 0.5
_SMOOTH_M: Final = 2.0
_SIDEWAYS_MPS2: Final = 2.2
_BRAKING_MPS2: Final = 1.4
_NO_LANE: Final = -1
_KERB_M: Final = 0.8


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of a way.

    Attributes:
        line: (N, 2) points, metres.
        speed_mps: allowed.
        lane: the lane that it follows, or None off the lanes.
        at_m: where on the lane it begins.
        change_m: over this length the way moves across from the piece before, which goes on beside it; 0: it follows
            where that ends.
    """

    line: Float64
    speed_mps: float
    lane: Lane | None = None
    at_m: float = 0.0
    change_m: float = 0.0


@dataclass(frozen=True)
class Halt:
    """A place on a way where one may have to stop.

    Attributes:
        at_m: along the way.
        group: signal group that opens it, or None.
        clear_m: where what lies behind it (a crossing) ends: it is not entered when that place is taken.
        on_foot: whether it is for people on foot.
    """

    at_m: float
    group: int | None
    clear_m: float
    on_foot: bool = False


@dataclass(frozen=True, eq=False)
class Way:
    """A smooth line that one follows, and what lies along it.

    Attributes:
        points: (N, 2) every `STEP_M` along it.
        lanes: the lanes that it uses, in order.
        lane_of: (N,) number of each point's lane among ``lanes``, or -1.
        allowed_mps: (N,) speed allowed at each point.
        halts: in order.
    """

    points: Float64
    lanes: tuple[Lane, ...]
    lane_of: Int32
    allowed_mps: Float64
    halts: tuple[Halt, ...]

    @property
    def length_m(self) -> float:
        """Of the line."""
        return STEP_M * (len(self.points) - 1)

    @cached_property
    def bounds(self) -> tuple[Float64, Float64]:
        """Its least and its greatest x and y."""
        return self.points.min(axis=0), self.points.max(axis=0)

    @cached_property
    def heading_rad(self) -> Float64:
        """(N,) unwrapped directions."""
        step = np.gradient(self.points, axis=0)
        return np.unwrap(np.arctan2(step[:, 1], step[:, 0]))

    @cached_property
    def pace_mps(self) -> Float64:
        """(N,) the speed at which one drives there: bends are slowed down for in time."""
        bend = np.abs(np.gradient(self.heading_rad, STEP_M))
        squared = np.minimum(self.allowed_mps**2, _SIDEWAYS_MPS2 / np.maximum(bend, 1e-4))
        # Slowing down at a constant rate is a line in the square of the speed.
        slope = 2.0 * _BRAKING_MPS2 * STEP_M * np.arange(len(squared))
        return np.sqrt(np.minimum.accumulate((squared + slope)[::-1])[::-1] - slope)

    def at(self, along_m: float) -> Float64:
        """(2,) the point at a length."""
        place = STEP_M * np.arange(len(self.points))
        return np.array([np.interp(along_m, place, self.points[:, axis]) for axis in (0, 1)])

    def gap_m(self, point: Float64) -> float:
        """How closely the way passes a point (2,)."""
        return float(np.sqrt(np.min(np.sum((self.points - point) ** 2, axis=1))))

    def nearest_m(self, point: Float64) -> float:
        """The length at which the way passes a point (2,) most closely."""
        return STEP_M * float(np.argmin(np.sum((self.points - point) ** 2, axis=1)))


def lane_piece(
    lane: Lane, begin_m: float = 0.0, end_m: float | None = None, *, aside_m: float = 0.0, change_m: float = 0.0
) -> Piece:
    """A stretch of a lane.

    Args:
        lane: that is followed.
        begin_m: where on it the piece begins.
        end_m: where it ends; default: the lane's end.
        aside_m: how far right of its middle.
        change_m: see `Piece`.
    """
    end = lane.length_m if end_m is None else min(end_m, lane.length_m)
    inside = (lane.along_m > begin_m + 1e-3) & (lane.along_m < end - 1e-3)
    along = np.concatenate([[begin_m], lane.along_m[inside], [end]])
    line = np.column_stack([np.interp(along, lane.along_m, lane.line[:, axis]) for axis in (0, 1)])
    if aside_m:
        line = line + aside_m * _right_of(line)
    return Piece(line, lane.speed_mps, lane, begin_m, change_m)


def build_way(pieces: Sequence[Piece]) -> Way:
    """Join pieces into one way; corners are rounded over two metres, and the way is straight beyond its ends.

    Raises:
        UsageError: there is nothing to join, or it is no longer than a step.
    """
    if not pieces:
        raise UsageError("a way of no pieces", expected="at least one")
    rough, owner = _joined(pieces)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rough, axis=0).T))])
    if length[-1] < 2 * STEP_M:
        raise UsageError(f"a way of {length[-1]:.2f} m", expected=f"at least {2 * STEP_M} m")
    even = STEP_M * np.arange(int(length[-1] / STEP_M) + 1)
    points = _smoothed(np.column_stack([np.interp(even, length, rough[:, axis]) for axis in (0, 1)]))
    piece_of = owner[np.searchsorted(length, even, side="right") - 1]
    lanes = tuple(piece.lane for piece in pieces if piece.lane is not None)
    number = np.cumsum([piece.lane is not None for piece in pieces]) - 1
    lane_of = np.array([_NO_LANE if piece.lane is None else n for piece, n in zip(pieces, number)], np.int32)[piece_of]
    allowed = np.array([piece.speed_mps for piece in pieces])[piece_of]
    starts = STEP_M * np.searchsorted(piece_of, np.arange(len(pieces))).astype(np.float64)
    return Way(points, lanes, lane_of, allowed, _halts(pieces, starts, even[-1]))


def _joined(pieces: Sequence[Piece]) -> tuple[Float64, Int32]:
    """Points (N, 2) of all pieces without repeats, and the piece (N,) of each."""
    lines: list[Float64] = []
    for piece in pieces:
        line = piece.line
        if piece.change_m and lines:
            line = _moved_across(lines[-1], line, piece.change_m)
            lines[-1] = _cut(lines[-1], max(_length(lines[-1]) - piece.change_m, STEP_M))
        lines.append(line)
    points = np.vstack(lines)
    owner = np.repeat(np.arange(len(lines), dtype=np.int32), [len(line) for line in lines])
    # Where two pieces join, the point is the second one's.
    new = np.concatenate([np.hypot(*np.diff(points, axis=0).T) > 1e-3, [True]])
    return points[new], owner[new]


def _moved_across(before: Float64, line: Float64, change_m: float) -> Float64:
    """``line`` from beside the last ``change_m`` of ``before`` on, which it leaves smoothly."""
    total = _length(before)
    start = max(total - change_m, 0.0)
    along = np.linspace(start, total, max(int((total - start) / STEP_M), 8))
    old = _points_at(before, along)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    beside = np.array([length[np.argmin(np.sum((line - point) ** 2, axis=1))] for point in (old[0], old[-1])])
    share = np.linspace(0.0, 1.0, len(old))
    new = _points_at(line, beside[0] + (beside[1] - beside[0]) * share)
    # The quintic step has no jump in curvature at its ends.
    weight = (share**3 * (10.0 - 15.0 * share + 6.0 * share**2))[:, None]
    return np.vstack([old + weight * (new - old), line[length > beside[1] + 1e-3]])


def _halts(pieces: Sequence[Piece], starts: Float64, end_m: float) -> tuple[Halt, ...]:
    found = []
    for number, piece in enumerate(pieces):
        lane = piece.lane
        stop = None if lane is None else _stop_m(lane)
        if lane is None or stop is None or stop < piece.at_m:
            continue
        at = float(starts[number] + stop - piece.at_m)
        next_at = starts[number + 1] if number + 1 < len(pieces) else end_m
        if at > next_at + 1.0:
            continue
        after = [n for n in range(number + 1, len(pieces)) if _of(pieces[n]) not in ("turn", "cross")]
        clear = float(starts[after[0]]) if after else end_m
        found.append(Halt(at, lane.signal, clear, lane.use in ("walk", "cross")))
    return tuple(found)


def _stop_m(lane: Lane) -> float | None:
    """Where one waits on a lane: people who cross at a signal wait by the kerb."""
    return _KERB_M if lane.stop_m is None and lane.signal is not None and lane.use == "cross" else lane.stop_m


def _of(piece: Piece) -> str | None:
    return None if piece.lane is None else piece.lane.use


def _smoothed(points: Float64) -> Float64:
    """Points averaged over a triangle of twice `_SMOOTH_M`."""
    half = round(_SMOOTH_M / STEP_M)
    reach = 2 * half
    window = np.convolve(np.ones(half + 1), np.ones(half + 1))
    window /= window.sum()
    steps = np.arange(reach, 0, -1)[:, None]
    head = points[0] - steps * (points[1] - points[0])
    tail = points[-1] + steps[::-1] * (points[-1] - points[-2])
    long = np.vstack([head, points, tail])
    offset = reach - half
    smooth = np.column_stack([np.convolve(long[:, axis], window, "valid") for axis in (0, 1)])
    return smooth[offset : offset + len(points)]


def _right_of(line: Float64) -> Float64:
    """(N, 2) unit vectors to the right of a line."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.column_stack([tangent[:, 1], -tangent[:, 0]])


def _length(line: Float64) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def _points_at(line: Float64, along_m: Float64) -> Float64:
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    return np.column_stack([np.interp(along_m, length, line[:, axis]) for axis in (0, 1)])


def _cut(line: Float64, end_m: float) -> Float64:
    return _points_at(line, np.linspace(0.0, end_m, max(int(end_m / STEP_M), 2)))


def changed(lane: Lane, other: Lane, begin_m: float, length_m: float) -> list[Piece]:
    """A lane up to a change to the one beside it, and that one from there to its end.

    Args:
        lane: the way is on.
        other: it changes to.
        begin_m: where on ``lane`` the change begins.
        length_m: of the change.
    """
    place = np.array([np.interp(begin_m, lane.along_m, lane.line[:, axis]) for axis in (0, 1)])
    beside = float(other.along_m[np.argmin(np.sum((other.line[:, :2] - place) ** 2, axis=1))])
    return [lane_piece(lane, 0.0, begin_m + length_m), lane_piece(other, beside, change_m=length_m)]


def followed(network: Network, lane_ids: Sequence[str], *, aside_m: float = 0.0) -> Way:
    """The way along whole lanes, one after the other."""
    return build_way([lane_piece(network.lanes[lane_id], aside_m=aside_m) for lane_id in lane_ids])
