"""Logs of states for the tests of safety."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from mirror.metrics.safety.state_log import StateLog


@dataclass(frozen=True, eq=False)
class Actor:
    """A box and its states (T, 5): x, y, yaw, vx, vy; a single state stays the same apart from its motion."""

    states: np.ndarray
    length_m: float = 4.5
    width_m: float = 1.8
    category: str = "car"


def constant(x: float, y: float, yaw: float, speed: float, times: Sequence[float], **box) -> Actor:
    """An actor that drives along its heading at a constant signed speed."""
    times = np.asarray(times)
    vx, vy = speed * np.cos(yaw), speed * np.sin(yaw)
    columns = [
        x + vx * times,
        y + vy * times,
        np.full_like(times, yaw),
        np.full_like(times, vx),
        np.full_like(times, vy),
    ]
    return Actor(np.stack(columns, axis=1), **box)


def state_log(times: Sequence[float], *actors: Actor, present: np.ndarray | None = None) -> StateLog:
    """A log of actors, the first of which is the ego."""
    states = np.stack([actor.states for actor in actors], axis=1)
    names = ("ego", *(f"agent{number}" for number in range(1, len(actors))))
    return StateLog(
        stamps_ns=1_700_000_000_000_000_000 + np.round(np.asarray(times) * 1e9).astype(np.int64),
        **{name: states[..., column] for column, name in enumerate(("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps"))},
        length_m=np.array([actor.length_m for actor in actors]),
        width_m=np.array([actor.width_m for actor in actors]),
        present=np.ones(states.shape[:2], bool) if present is None else present,
        ids=names,
        categories=tuple(actor.category for actor in actors),
        rear_axle_to_center_m=1.4,
    )


def random_log(rng: np.random.Generator, *, agents: int = 3, stamps: int = 12, period_s: float = 0.1) -> StateLog:
    """Actors that drive about a small place with changing headings and speeds."""
    times = period_s * np.arange(stamps)
    actors = []
    for _ in range(agents + 1):
        speed, rate = rng.uniform(-3.0, 15.0), rng.uniform(-1.0, 1.0)
        yaw = rng.uniform(-np.pi, np.pi) + rate * times
        x = rng.uniform(-12, 12) + np.cumsum(speed * period_s * np.cos(yaw))
        y = rng.uniform(-12, 12) + np.cumsum(speed * period_s * np.sin(yaw))
        states = np.stack([x, y, np.angle(np.exp(1j * yaw)), speed * np.cos(yaw), speed * np.sin(yaw)], axis=1)
        actors.append(Actor(states, rng.uniform(0.5, 6.0), rng.uniform(0.4, 2.5)))
    return state_log(times, *actors)


def resample(log: StateLog, factor: int) -> StateLog:
    """The same motion with ``factor`` times as many stamps."""
    rows = np.arange((len(log.stamps_ns) - 1) * factor + 1) / factor
    lower = np.minimum(rows.astype(int), len(log.stamps_ns) - 2)
    share = (rows - lower)[:, None]

    def between(values: np.ndarray) -> np.ndarray:
        return (1 - share) * values[lower] + share * values[lower + 1]

    steps = log.stamps_ns[1:] - log.stamps_ns[:-1]
    return replace(
        log,
        stamps_ns=log.stamps_ns[lower] + np.round((rows - lower) * steps[lower]).astype(np.int64),
        yaw_rad=between(np.unwrap(log.yaw_rad, axis=0)),
        present=np.ones((len(rows), len(log.ids)), bool),
        **{name: between(getattr(log, name)) for name in ("x_m", "y_m", "vx_mps", "vy_mps")},
    )


def moved(log: StateLog, x_m: float, y_m: float, turn_rad: float) -> StateLog:
    """The log in another frame."""
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    return replace(
        log,
        x_m=cos * log.x_m - sin * log.y_m + x_m,
        y_m=sin * log.x_m + cos * log.y_m + y_m,
        yaw_rad=np.angle(np.exp(1j * (log.yaw_rad + turn_rad))),
        vx_mps=cos * log.vx_mps - sin * log.vy_mps,
        vy_mps=sin * log.vx_mps + cos * log.vy_mps,
    )


def rectangle(x: float, y: float, yaw: float, length: float, width: float) -> shapely.Polygon:
    """A box seen from above."""
    forward = 0.5 * length * np.array([np.cos(yaw), np.sin(yaw)])
    left = 0.5 * width * np.array([-np.sin(yaw), np.cos(yaw)])
    center = np.array([x, y])
    return shapely.Polygon(
        [center + forward + left, center + forward - left, center - forward - left, center - forward + left]
    )


def polygon(log: StateLog, actor: int, row: int, ahead_s: float = 0.0) -> shapely.Polygon:
    """An actor's box at a stamp, or some time later at its velocity of then."""
    return rectangle(
        log.x_m[row, actor] + ahead_s * log.vx_mps[row, actor],
        log.y_m[row, actor] + ahead_s * log.vy_mps[row, actor],
        log.yaw_rad[row, actor],
        log.length_m[actor],
        log.width_m[actor],
    )


def polygons(
    log: StateLog, actor: int, row: int | slice = slice(None), ahead_s: float | np.ndarray = 0.0
) -> np.ndarray:
    """The boxes (N,) of `polygon` at many stamps or many times ahead, made in one call of shapely."""
    x = np.atleast_1d(log.x_m[row, actor] + ahead_s * log.vx_mps[row, actor])
    y = np.atleast_1d(log.y_m[row, actor] + ahead_s * log.vy_mps[row, actor])
    yaw = np.broadcast_to(log.yaw_rad[row, actor], x.shape)
    along = 0.5 * log.length_m[actor] * np.array([1.0, -1.0, -1.0, 1.0])
    left = 0.5 * log.width_m[actor] * np.array([1.0, 1.0, -1.0, -1.0])
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    return shapely.polygons(
        np.stack([x[:, None] + cos * along - sin * left, y[:, None] + sin * along + cos * left], axis=-1)
    )
