"""Turning around in a street: out on one path, back on the parallel one."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.portable import arrays
from mirror.traffic.lanes.paths import Path, beside_m
from mirror.traffic.lanes.ways import STEP_M, Piece, Way, build_way, lane_piece

_SWING_M: Final = 4.9
_SWING_LEAD_M: Final = 18.0


def point_and_direction_at(path: Path, distance_m: float) -> tuple[Float64, Float64]:
    """Return the last point (2,) of a path at a distance from the origin, and the path's direction (2,) there."""
    line = path.line
    line = line[np.concatenate([[True], arrays.hypot(*np.diff(line, axis=0).T) > 1e-3])]
    distance = arrays.hypot(*line.T)
    last = int(np.argmin(distance))
    after = max(last + int(np.argmax(distance[last:] > distance_m)), 1)
    share = (distance_m - distance[after - 1]) / (distance[after] - distance[after - 1])
    step = line[after] - line[after - 1]
    return line[after - 1] + share * step, step / arrays.hypot(*step)


def build_turn_around(out: Path, home: Path, apex_m: float) -> tuple[Way, float]:
    """Build a way out on one path and back on another, which turns around at a distance from the origin.

    Returns:
        The way, and the length along it of the turn.
    """
    place, ahead = point_and_direction_at(out, apex_m - _SWING_M)
    left = np.array([-ahead[1], ahead[0]])
    across = arrays.matmul((home.line - place), np.column_stack([ahead, left]))
    gap = float(np.min(np.abs(across[np.abs(across[:, 0]) < 3.0, 1]), initial=np.inf))
    if not gap < 2.0 * _SWING_M:
        raise UsageError(
            f"no room to turn round {apex_m:.0f} m from the scene's middle",
            expected="a lane in the other direction beside the own",
            remedy="take another route, or another kind of scene",
        )
    # The way swings out to the right before the turn, so that the turn is wide enough for a car.
    aside = _SWING_M - 0.5 * gap
    angle = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 40)
    turn = (
        place + np.outer(_SWING_M * arrays.cos(angle), ahead) + np.outer(0.5 * gap + _SWING_M * arrays.sin(angle), left)
    )
    share = np.linspace(0.0, 1.0, 24)
    ease = aside * share * share * share * (10.0 - 15.0 * share + 6.0 * share**2)
    before = _beside(out, place, _SWING_LEAD_M * (share - 1.0), ease)
    after = _beside(home, place + gap * left, _SWING_LEAD_M * share, ease[::-1])
    pieces = [
        *_pieces_until(out, before[0]),
        Piece(np.vstack([before[1:], turn[1:-1], after[:-1]]), out.lanes[0].speed_mps),
        *_pieces_from(home, after[-1]),
    ]
    way = build_way(pieces)
    return way, way.nearest_m(place + ahead * _SWING_M + left * 0.5 * gap)


def _beside(path: Path, place: Float64, along_m: Float64, right_m: Float64) -> Float64:
    """Points (N, 2) at lengths along a path from a place on it, and at offsets to its right."""
    line = path.line
    line = line[np.concatenate([[True], arrays.hypot(*np.diff(line, axis=0).T) > 1e-3])]
    length = np.concatenate([[0.0], np.cumsum(arrays.hypot(*np.diff(line, axis=0).T))])
    step = np.gradient(line, length, axis=0)
    nearest = int(np.argmin(np.sum((line - place) ** 2, axis=1)))
    at = length[nearest] + float(arrays.matmul((place - line[nearest]), step[nearest])) + along_m
    points, ahead = (
        np.column_stack([np.interp(at, length, values[:, axis]) for axis in (0, 1)]) for values in (line, step)
    )
    return points + right_m[:, None] * np.column_stack([ahead[:, 1], -ahead[:, 0]])


def _pieces_until(path: Path, point: Float64) -> list[Piece]:
    """The part of a path before it passes a point."""
    last = int(np.argmin([arrays.hypot(*(lane.line[:, :2] - point).T).min() for lane in path.lanes]))
    pieces = [lane_piece(lane) for lane in path.lanes[:last]]
    return [*pieces, lane_piece(path.lanes[last], 0.0, max(beside_m(path.lanes[last], point), STEP_M))]


def _pieces_from(path: Path, point: Float64) -> list[Piece]:
    """The part of a path after it passes a point."""
    first = int(np.argmin([arrays.hypot(*(lane.line[:, :2] - point).T).min() for lane in path.lanes]))
    lane = path.lanes[first]
    return [lane_piece(lane, beside_m(lane, point)), *(lane_piece(lane) for lane in path.lanes[first + 1 :])]
