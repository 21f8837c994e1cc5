"""The ego on the lanes of a map: between lanes, in a junction, in a lane of the other direction, at a red light."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import UsageError
from mirror.metrics.safety.state_log import StateLog
from mirror.schema.road_features import DRIVING, SIGNAL_STATES, MapLane
from mirror.schema.road_map import RoadMap

_RED = tuple(index for index, state in enumerate(SIGNAL_STATES) if state in ("red", "red_amber"))
_CORNERS, _CENTER, _REAR_AXLE = slice(0, 4), 4, 5


@dataclass(frozen=True, eq=False)
class LanePositions:
    """The ego on the driving lanes of a map, at T stamps.

    Attributes:
        lanes: the L driving lanes.
        corners_inside: (T, L) number of the ego's corners in each lane.
        center_offset_m: (T, L) offset of the ego's centre to the left of each lane's middle; NaN where it is outside.
        center_along_m: (T, L) length along the lane; NaN where it is outside.
        turned_rad: (T, L) the ego's heading relative to the lane; NaN where it is outside.
        between_lanes: (T,) several lanes have a corner in them and no lane has all four (NAVSIM, "multiple lanes").
        in_junction: (T,) the rear axle is in a lane through a junction.
        is_oncoming: (T,) the centre is in a lane of the opposite direction, in none of its own, and not in a junction.
    """

    lanes: tuple[MapLane, ...]
    corners_inside: Int64
    center_offset_m: Float64
    center_along_m: Float64
    turned_rad: Float64
    between_lanes: Bool
    in_junction: Bool
    is_oncoming: Bool


@dataclass(frozen=True)
class RedLight:
    """A stop line that the ego passed at red.

    Attributes:
        signal: id of the signal.
        lane: id of the lane.
        stamp_ns: stamp at which the ego's front passed the stop line.
    """

    signal: str
    lane: str
    stamp_ns: int


@dataclass(frozen=True, eq=False)
class _LaneArrays:
    """The driving lanes of a map as arrays, relative to an origin."""

    lanes: tuple[MapLane, ...]
    origin: Float64
    line: Float64
    half: Float64
    first: Int64


@lru_cache(maxsize=8)
def _lane_arrays(road_map: RoadMap) -> _LaneArrays:
    lanes = road_map.lanes_of(DRIVING)
    counts = [len(lane.center_m) for lane in lanes]
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    if not lanes:
        return _LaneArrays((), np.zeros(2), np.zeros((0, 3)), np.zeros(0), first)
    origin = lanes[0].center_m[0, :2].copy()
    line = np.concatenate([np.column_stack([lane.center_m[:, :2] - origin, lane.along_m]) for lane in lanes])
    return _LaneArrays(lanes, origin, line, 0.5 * np.concatenate([lane.width_m for lane in lanes]), first)


def ego_points(log: StateLog) -> Float64:
    """Return six points (T, 6, 2) of the ego.

    They are its corners (front left, front right, rear right, rear left), its centre and its rear axle.
    """
    cos, sin = np.cos(log.yaw_rad[:, 0]), np.sin(log.yaw_rad[:, 0])
    half_length, half_width = 0.5 * log.length_m[0], 0.5 * log.width_m[0]
    ahead = np.array([half_length, half_length, -half_length, -half_length, 0.0, -log.rear_axle_to_center_m])
    left = np.array([half_width, -half_width, -half_width, half_width, 0.0, 0.0])
    x = log.x_m[:, :1] + cos[:, None] * ahead - sin[:, None] * left
    y = log.y_m[:, :1] + sin[:, None] * ahead + cos[:, None] * left
    return np.stack([x, y], axis=2)


def locate_on_lanes(log: StateLog, road_map: RoadMap) -> LanePositions:
    """Find the driving lanes that the ego is in, at every stamp.

    A point is in a lane if the nearest point of the lane's middle line lies between the line's ends and not farther
    than half of the width.

    Args:
        log: states; only the ego is read.
        road_map: the map, in the frame of the log.
    """
    from mirror.metrics.safety.lane_kernels import project_on_lanes

    arrays, stamps = _lane_arrays(road_map), len(log.stamps_ns)
    points = (ego_points(log) - arrays.origin).reshape(-1, 2)
    projected = project_on_lanes(points, arrays.line, arrays.half, arrays.first)
    offset, along, direction = (values.reshape(stamps, 6, -1) for values in projected)
    inside = ~np.isnan(offset)
    corners = inside[:, _CORNERS].sum(axis=1)
    turned = log.yaw_rad[:, :1] - direction[:, _CENTER]
    turned -= 2.0 * np.pi * np.round(turned / (2.0 * np.pi))
    is_turn = np.array([lane.kind == "turn" for lane in arrays.lanes], np.bool_)
    in_junction = np.any(inside[:, _REAR_AXLE] & is_turn, axis=1)
    own = np.abs(turned) <= 0.5 * np.pi
    others = inside[:, _CENTER] & ~own
    crosses_junction = np.any(inside[:, _CENTER] & is_turn, axis=1)
    return LanePositions(
        lanes=arrays.lanes,
        corners_inside=corners,
        center_offset_m=offset[:, _CENTER],
        center_along_m=along[:, _CENTER],
        turned_rad=turned,
        between_lanes=((corners > 0).sum(axis=1) > 1) & ~(corners == 4).any(axis=1),
        in_junction=in_junction,
        is_oncoming=np.any(others, axis=1) & ~np.any(inside[:, _CENTER] & own, axis=1) & ~crosses_junction,
    )


def lanes_of_route(route_m: Float64, road_map: RoadMap) -> Bool:
    """Mark the driving lanes (L,) of a map that a route (K, 2) runs through in their direction."""
    from mirror.metrics.safety.lane_kernels import project_on_lanes

    arrays = _lane_arrays(road_map)
    _, _, direction = project_on_lanes(route_m - arrays.origin, arrays.line, arrays.half, arrays.first)
    ahead = np.gradient(route_m, axis=0)
    course = np.arctan2(ahead[:, 1], ahead[:, 0])
    with np.errstate(invalid="ignore"):
        return np.any(np.cos(course[:, None] - direction) > 0.0, axis=0)


def driven_steps(log: StateLog) -> Float64:
    """Return the distances (T - 1,) that the ego's centre moves between stamps."""
    return np.asarray(np.hypot(np.diff(log.x_m[:, 0]), np.diff(log.y_m[:, 0])))


def driven_while(log: StateLog, holds: Bool) -> float:
    """Return the distance driven while a condition (T,) holds; a step with only one end in it counts half."""
    steps, weight = driven_steps(log), 0.5 * (holds[1:].astype(np.float64) + holds[:-1])
    return float((steps * weight).sum())


def find_red_lights(log: StateLog, road_map: RoadMap, positions: LanePositions | None = None) -> tuple[RedLight, ...]:
    """Find the stop lines that the ego's front passes while the signal shows red, or red and amber.

    The passing is interpolated between the stamps; the state of the signal is that of the stamp before it. Where a
    lane with a signal has no stop line, its end counts.

    Args:
        log: states of the ego and the signals.
        road_map: the map, in the frame of the log.
        positions: the ego on the lanes of this map, if known.

    Raises:
        UsageError: the log lacks a signal of a driving lane.
    """
    positions = locate_on_lanes(log, road_map) if positions is None else positions
    rows = {name: index for index, name in enumerate(log.signals)}
    times, found = log.times_s, []
    for index, lane in enumerate(positions.lanes):
        if lane.signal is None:
            continue
        if lane.signal not in rows:
            raise UsageError(
                f"the log has no states of signal {lane.signal!r}",
                expected=f"the signals {', '.join(road_map.signals)}",
            )
        stop = lane.length_m if lane.stop_m is None else lane.stop_m
        own = np.abs(positions.turned_rad[:, index]) <= 0.5 * np.pi
        ahead = np.where(own, positions.center_along_m[:, index] + 0.5 * log.length_m[0] - stop, np.nan)
        # Where the ego leaves the lane within a step, it is taken to go on as it did.
        onwards = ahead[:-1] + driven_steps(log) * np.cos(positions.turned_rad[:-1, index])
        after = np.where(np.isnan(ahead[1:]), onwards, ahead[1:])
        with np.errstate(invalid="ignore"):
            passes = np.flatnonzero((ahead[:-1] <= 0.0) & (after > 0.0))
        for row in passes.tolist():
            share = -ahead[row] / (after[row] - ahead[row])
            time = float((1.0 - share) * times[row] + share * times[row + 1])
            # A passing exactly at a stamp has that stamp's state.
            before = row + int(share >= 1.0)
            if log.shown_signals[before, rows[lane.signal]] in _RED:
                found.append(RedLight(lane.signal, lane.lane_id, log.stamp_at(time)))
    return tuple(sorted(found, key=lambda one: (one.stamp_ns, one.lane)))
