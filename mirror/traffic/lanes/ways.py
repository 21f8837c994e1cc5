"""Ways: lanes joined into one smooth line, with the speed that its bends allow and the places to stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int32
from mirror.errors import UsageError
from mirror.portable import arrays
from mirror.traffic.lanes.network import Lane, Network

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
        speed_mps: speed limit.
        lane: lane that the piece follows; None outside lanes.
        at_m: length along the lane at which the piece begins.
        change_m: length of the lane change from the preceding, parallel piece; 0: the piece follows the end of the
            preceding one.
    """

    line: Float64
    speed_mps: float
    lane: Lane | None = None
    at_m: float = 0.0
    change_m: float = 0.0


@dataclass(frozen=True)
class Halt:
    """A place on a way where road users may have to stop.

    Attributes:
        at_m: length along the way.
        group: signal group that controls the place, or None.
        clear_m: end of the crossing behind it; a road user does not enter the crossing while it cannot leave it.
        on_foot: whether the place is for pedestrians.
    """

    at_m: float
    group: int | None
    clear_m: float
    on_foot: bool = False


@dataclass(frozen=True, eq=False)
class Way:
    """A smooth line that road users follow, with its lanes, speeds and stopping places.

    Attributes:
        points: (N, 2) points every `STEP_M`, metres.
        lanes: lanes of the way, in order.
        lane_of: (N,) index of each point's lane in ``lanes``, or -1.
        allowed_mps: (N,) speed limit at each point.
        halts: stopping places, in order.
    """

    points: Float64
    lanes: tuple[Lane, ...]
    lane_of: Int32
    allowed_mps: Float64
    halts: tuple[Halt, ...]

    @property
    def length_m(self) -> float:
        """Length of the line."""
        return STEP_M * (len(self.points) - 1)

    @cached_property
    def bounds(self) -> tuple[Float64, Float64]:
        """The least and the greatest x and y."""
        return self.points.min(axis=0), self.points.max(axis=0)

    @cached_property
    def heading_rad(self) -> Float64:
        """(N,) unwrapped directions, radians."""
        step = np.gradient(self.points, axis=0)
        return np.unwrap(arrays.arctan2(step[:, 1], step[:, 0]))

    @cached_property
    def pace_mps(self) -> Float64:
        """(N,) driving speed at each point, with deceleration before bends."""
        bend = np.abs(np.gradient(self.heading_rad, STEP_M))
        squared = np.minimum(self.allowed_mps**2, _SIDEWAYS_MPS2 / np.maximum(bend, 1e-4))
        # With a constant deceleration the square of the speed is linear in the length.
        slope = 2.0 * _BRAKING_MPS2 * STEP_M * np.arange(len(squared))
        return np.sqrt(np.minimum.accumulate((squared + slope)[::-1])[::-1] - slope)

    def at(self, along_m: float) -> Float64:
        """Return the point (2,) at a length."""
        place = STEP_M * np.arange(len(self.points))
        return np.array([np.interp(along_m, place, self.points[:, axis]) for axis in (0, 1)])

    def points_at(self, along_m: Float64) -> Float64:
        """Return the points (N, 2) at lengths (N,)."""
        place = STEP_M * np.arange(len(self.points))
        return np.column_stack([np.interp(along_m, place, self.points[:, axis]) for axis in (0, 1)])

    def gap_m(self, point: Float64) -> float:
        """Return the distance between the way and a point (2,)."""
        return float(np.sqrt(np.min(np.sum((self.points - point) ** 2, axis=1))))

    def nearest_m(self, point: Float64) -> float:
        """Return the length at which the way is closest to a point (2,)."""
        return STEP_M * float(np.argmin(np.sum((self.points - point) ** 2, axis=1)))


def lane_piece(
    lane: Lane, begin_m: float = 0.0, end_m: float | None = None, *, aside_m: float = 0.0, change_m: float = 0.0
) -> Piece:
    """Return a piece of a lane.

    Args:
        lane: the lane.
        begin_m: length at which the piece begins.
        end_m: length at which it ends; default: the end of the lane.
        aside_m: offset to the right of the lane's middle.
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
    """Join pieces into one way, with corners rounded over two metres and straight ends beyond it.

    Raises:
        UsageError: there are no pieces, or the way is not longer than a step.
    """
    if not pieces:
        raise UsageError("a way of 0 pieces", expected="at least one piece")
    rough, owner = _join(pieces)
    length = np.concatenate([[0.0], np.cumsum(arrays.hypot(*np.diff(rough, axis=0).T))])
    if length[-1] < 2 * STEP_M:
        raise UsageError(f"a way of {length[-1]:.2f} m", expected=f"at least {2 * STEP_M} m")
    even = STEP_M * np.arange(int(length[-1] / STEP_M) + 1)
    points = _smooth(np.column_stack([np.interp(even, length, rough[:, axis]) for axis in (0, 1)]))
    piece_of = owner[np.searchsorted(length, even, side="right") - 1]
    lanes = tuple(piece.lane for piece in pieces if piece.lane is not None)
    number = np.cumsum([piece.lane is not None for piece in pieces]) - 1
    lane_of = np.array([_NO_LANE if piece.lane is None else n for piece, n in zip(pieces, number)], np.int32)[piece_of]
    allowed = np.array([piece.speed_mps for piece in pieces])[piece_of]
    starts = STEP_M * np.searchsorted(piece_of, np.arange(len(pieces))).astype(np.float64)
    return Way(points, lanes, lane_of, allowed, _halts(pieces, starts, even[-1]))


def _join(pieces: Sequence[Piece]) -> tuple[Float64, Int32]:
    """Points (N, 2) of all pieces without duplicates, and the index (N,) of each point's piece."""
    lines: list[Float64] = []
    for piece in pieces:
        line = piece.line
        if piece.change_m and lines:
            line = _shift_across(lines[-1], line, piece.change_m)
            lines[-1] = _cut_line(lines[-1], max(_length(lines[-1]) - piece.change_m, STEP_M))
        lines.append(line)
    points = np.vstack(lines)
    owner = np.repeat(np.arange(len(lines), dtype=np.int32), [len(line) for line in lines])
    # The point between two pieces belongs to the second one.
    new = np.concatenate([arrays.hypot(*np.diff(points, axis=0).T) > 1e-3, [True]])
    return points[new], owner[new]


def _shift_across(before: Float64, line: Float64, change_m: float) -> Float64:
    """The part of ``line`` beside the last ``change_m`` of ``before``, with a smooth change from ``before``."""
    total = _length(before)
    start = max(total - change_m, 0.0)
    along = np.linspace(start, total, max(int((total - start) / STEP_M), 8))
    old = _points_at(before, along)
    length = np.concatenate([[0.0], np.cumsum(arrays.hypot(*np.diff(line, axis=0).T))])
    beside = np.array([length[np.argmin(np.sum((line - point) ** 2, axis=1))] for point in (old[0], old[-1])])
    share = np.linspace(0.0, 1.0, len(old))
    new = _points_at(line, beside[0] + (beside[1] - beside[0]) * share)
    # The quintic step has a continuous curvature at its ends.
    weight = (share * share * share * (10.0 - 15.0 * share + 6.0 * share**2))[:, None]
    return np.vstack([old + weight * (new - old), line[length > beside[1] + 1e-3]])


def _halts(pieces: Sequence[Piece], starts: Float64, end_m: float) -> tuple[Halt, ...]:
    halts = []
    for number, piece in enumerate(pieces):
        lane = piece.lane
        stop = None if lane is None else _stop_m(lane)
        if lane is None or stop is None or stop < piece.at_m:
            continue
        at = float(starts[number] + stop - piece.at_m)
        next_at = starts[number + 1] if number + 1 < len(pieces) else end_m
        if at > next_at + 1.0:
            continue
        after = [n for n in range(number + 1, len(pieces)) if _lane_use(pieces[n]) not in ("turn", "cross")]
        clear = float(starts[after[0]]) if after else end_m
        halts.append(Halt(at, lane.signal, clear, lane.use in ("walk", "cross")))
    return tuple(halts)


def _stop_m(lane: Lane) -> float | None:
    """The length at which road users wait on a lane; pedestrians wait at the kerb of a signalled crossing."""
    return _KERB_M if lane.stop_m is None and lane.signal is not None and lane.use == "cross" else lane.stop_m


def _lane_use(piece: Piece) -> str | None:
    return None if piece.lane is None else piece.lane.use


def _smooth(points: Float64) -> Float64:
    """Smooth points with a triangular kernel of width twice `_SMOOTH_M`."""
    half = round(_SMOOTH_M / STEP_M)
    reach = 2 * half
    rising = np.arange(1.0, half + 2.0)
    window = np.concatenate([rising, rising[-2::-1]])
    window /= window.sum()
    steps = np.arange(reach, 0, -1)[:, None]
    head = points[0] - steps * (points[1] - points[0])
    tail = points[-1] + steps[::-1] * (points[-1] - points[-2])
    long = np.vstack([head, points, tail])
    offset = reach - half
    smooth = np.column_stack([arrays.convolve(long[:, axis], window) for axis in (0, 1)])
    return smooth[offset : offset + len(points)]


def _right_of(line: Float64) -> Float64:
    """(N, 2) unit vectors to the right of a line."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.column_stack([tangent[:, 1], -tangent[:, 0]])


def _length(line: Float64) -> float:
    return float(arrays.hypot(*np.diff(line, axis=0).T).sum())


def _points_at(line: Float64, along_m: Float64) -> Float64:
    length = np.concatenate([[0.0], np.cumsum(arrays.hypot(*np.diff(line, axis=0).T))])
    return np.column_stack([np.interp(along_m, length, line[:, axis]) for axis in (0, 1)])


def _cut_line(line: Float64, end_m: float) -> Float64:
    return _points_at(line, np.linspace(0.0, end_m, max(int(end_m / STEP_M), 2)))


def change_lane_pieces(lane: Lane, other: Lane, begin_m: float, length_m: float) -> list[Piece]:
    """Return the pieces of a lane change: a lane up to the change, and the neighbouring lane after it.

    Args:
        lane: lane before the change.
        other: lane after the change.
        begin_m: length along ``lane`` at which the change begins.
        length_m: length of the change.
    """
    place = np.array([np.interp(begin_m, lane.along_m, lane.line[:, axis]) for axis in (0, 1)])
    beside = float(other.along_m[np.argmin(np.sum((other.line[:, :2] - place) ** 2, axis=1))])
    return [lane_piece(lane, 0.0, begin_m + length_m), lane_piece(other, beside, change_m=length_m)]


def follow_lanes(network: Network, lane_ids: Sequence[str], *, aside_m: float = 0.0) -> Way:
    """Build the way along a sequence of whole lanes."""
    return build_way([lane_piece(network.lanes[lane_id], aside_m=aside_m) for lane_id in lane_ids])
