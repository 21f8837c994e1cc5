"""State logs for the benchmark: traffic on the lanes of a synthetic street, contacts and near misses."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64
from mirror.metrics.safety import StateLog
from mirror.schema.road_map import MapLane, RoadMap

LENGTH_M: Final = 4.7
WIDTH_M: Final = 1.85
_COLUMNS: Final = ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps")


def traffic_log(road_map: RoadMap, agents: int, seed: int, *, seconds: float = 20.0, rate_hz: float = 10.0) -> StateLog:
    """Return a log of an ego and agents that follow lanes at constant speeds, a little aside of their middles."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    lanes = sorted(road_map.lanes_of(), key=lambda lane: lane.length_m, reverse=True)
    states = [_follow(lanes[0], times, 2.0, (lanes[0].length_m - 4.0) / seconds, 0.0)]
    for _ in range(agents):
        lane = lanes[rng.integers(min(len(lanes), 20))]
        states.append(
            _follow(lane, times, rng.uniform(0.0, 0.8) * lane.length_m, rng.uniform(0.0, 12.0), rng.normal(0, 0.4))
        )
    log = _log(times, np.stack(states, axis=1))
    shown = np.zeros((len(times), len(road_map.signals)), np.int8)
    return replace(log, signals=tuple(road_map.signals), signal_states=shown)


def _log(times: Float64, columns: Float64) -> StateLog:
    """The log of states (T, N, 5) of cars."""
    count = columns.shape[1]
    x, y, yaw, vx, vy = np.moveaxis(columns, 2, 0)
    return StateLog(
        stamps_ns=np.round(times * 1e9).astype(np.int64),
        x_m=x,
        y_m=y,
        yaw_rad=yaw,
        vx_mps=vx,
        vy_mps=vy,
        length_m=np.full(count, LENGTH_M),
        width_m=np.full(count, WIDTH_M),
        present=np.ones((len(times), count), np.bool_),
        ids=("ego", *(f"agent{number:03d}" for number in range(1, count))),
        categories=("car",) * count,
        rear_axle_to_center_m=1.4,
    )


def near_misses(agents: int, seed: int, *, touching: bool) -> StateLog:
    """Return a log of an ego that weaves along x, and agents that cross and meet it on arcs.

    Args:
        agents: number of agents.
        seed: seed of their motions.
        touching: agents of which the boxes touch the ego's; otherwise agents that pass it at some distance.
    """
    rng = np.random.default_rng([seed, int(touching)])
    times: Float64 = 0.1 * np.arange(51, dtype=np.float64)
    speed, phase = rng.uniform(6.0, 14.0), rng.uniform(0.0, 2.0 * np.pi)
    yaw = 0.15 * np.sin(times + phase)
    states = [_drive(times, yaw, speed, np.zeros(2), 0)]
    while len(states) <= agents:
        # The agent passes the ego's place of some instant, aside by up to four metres.
        row = int(rng.integers(10, 45))
        yaw = rng.uniform(-np.pi, np.pi) + rng.uniform(-0.4, 0.4) * (times - times[row])
        place = states[0][row, :2] + (0.0 if touching else 1.0) * rng.uniform(-4.0, 4.0, 2)
        state = _drive(times, yaw, rng.uniform(0.5, 14.0), place, row)
        away = np.hypot(*(state[:, :2] - states[0][:, :2]).T).min()
        if touching or away > math.hypot(LENGTH_M, WIDTH_M):
            states.append(state)
    return _log(times, np.stack(states, axis=1))


def _drive(times: Float64, yaw: Float64, speed_mps: float, place: Float64, row: int) -> Float64:
    """(T, 5) states at a constant speed, through a place at a row."""
    velocity = speed_mps * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    steps = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(times)[:, None]
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.column_stack([points - points[row] + place, yaw, velocity])


def resample(log: StateLog, factor: int) -> StateLog:
    """Resample a log to ``factor`` times as many stamps of the same motion."""
    rows = np.arange((len(log.stamps_ns) - 1) * factor + 1) / factor
    low = np.minimum(rows.astype(np.int64), len(log.stamps_ns) - 2)
    share = (rows - low)[:, None]

    def between(values: Float64) -> Float64:
        return np.asarray((1.0 - share) * values[low] + share * values[low + 1])

    steps = np.diff(log.stamps_ns)
    columns: dict[str, Any] = {name: between(getattr(log, name)) for name in _COLUMNS if name != "yaw_rad"}
    return replace(
        log,
        stamps_ns=log.stamps_ns[low] + np.round((rows - low) * steps[low]).astype(np.int64),
        yaw_rad=between(np.unwrap(log.yaw_rad, axis=0)),
        present=np.ones((len(rows), len(log.ids)), np.bool_),
        signal_states=log.shown_signals[low],
        **columns,
    )


def _follow(lane: MapLane, times: Float64, begin_m: float, speed_mps: float, aside_m: float) -> Float64:
    """(T, 5) states along a lane; the actor stops at its end."""
    along = np.minimum(begin_m + speed_mps * times, lane.length_m)
    x, y = (np.interp(along, lane.along_m, lane.center_m[:, axis]) for axis in (0, 1))
    ends = [np.clip(along + offset, 0.0, lane.length_m) for offset in (-1.5, 1.5)]
    rear, front = (
        np.stack([np.interp(end, lane.along_m, lane.center_m[:, axis]) for axis in (0, 1)], axis=1) for end in ends
    )
    yaw = np.unwrap(np.arctan2(*(front - rear).T[::-1]))
    speed = np.where(along < lane.length_m, speed_mps, 0.0)
    x, y = x - aside_m * np.sin(yaw), y + aside_m * np.cos(yaw)
    return np.stack([x, y, yaw, speed * np.cos(yaw), speed * np.sin(yaw)], axis=1)
