"""Curves of a drive over its time: quantities at every state, computed from the states and the road map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.metrics.safety import StateLog, drivable_area_compliance, time_to_collision
from mirror.schema.road_map import RoadMap

FARTHEST_M: Final = 100.0
"""A road user farther ahead than this leaves no gap."""
LONGEST_S: Final = 10.0
"""A contact farther in the future than this is not drawn."""


@dataclass(frozen=True, eq=False)
class DriveCurve:
    """A quantity at every state of a drive.

    Attributes:
        title: its name.
        unit: its unit.
        about: its definition in words.
        values: (T,) values; NaN: there is none at this state.
        digits: number of decimal places in which it is shown.
    """

    title: str
    unit: str
    about: str
    values: Float64
    digits: int = 1


def speed_curve(log: StateLog) -> DriveCurve:
    """Return the speed of the ego."""
    return DriveCurve("Speed", "m/s", "of the ego", np.hypot(log.vx_mps[:, 0], log.vy_mps[:, 0]))


def gap_curve(log: StateLog) -> DriveCurve:
    """Return the free way ahead of the ego; see `measure_gap`."""
    about = f"from the front bumper to the next road user straight ahead, within the ego's width and {FARTHEST_M:g} m"
    return DriveCurve("Gap", "m", about, measure_gap(log))


def contact_curve(log: StateLog) -> DriveCurve:
    """Return the least time to collision of the ego."""
    times_s = time_to_collision(log).min(axis=1)
    about = f"until the ego touches a road user if all keep their velocities, up to {LONGEST_S:g} s"
    return DriveCurve("Time to collision", "s", about, np.where(times_s <= LONGEST_S, times_s, np.nan))


def margin_curve(log: StateLog, road_map: RoadMap) -> DriveCurve:
    """Return the margin of the ego to the road's edge, whose map is in the frame of the log."""
    margin = drivable_area_compliance(log, road_map.drivable_rings).margin_m
    about = "of the worst corner of the ego; negative: off the road"
    return DriveCurve("Margin to the road's edge", "m", about, np.asarray(margin, np.float64), 2)


def measure_gap(log: StateLog, *, farthest_m: float = FARTHEST_M) -> Float64:
    """Measure the free way ahead of the ego at each state.

    It is the distance along the heading from the front of the ego's box to the nearest part of another box that lies
    in the strip which the ego's width sweeps straight ahead; 0 where such a part lies beside the ego's front or behind
    it and the box reaches beyond the front.

    Args:
        log: states.
        farthest_m: parts beyond this distance do not count.

    Returns:
        (T,) metres; NaN where the strip is free.
    """
    half_length, half_width = 0.5 * log.length_m[0], 0.5 * log.width_m[0]
    cos, sin = np.cos(log.yaw_rad[:, :1]), np.sin(log.yaw_rad[:, :1])
    dx, dy = log.x_m[:, 1:] - log.x_m[:, :1], log.y_m[:, 1:] - log.y_m[:, :1]
    centre = np.stack([dx * cos + dy * sin, dy * cos - dx * sin], axis=-1)
    turn = log.yaw_rad[:, 1:] - log.yaw_rad[:, :1]
    ahead = 0.5 * log.length_m[1:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    left = 0.5 * log.width_m[1:, None] * np.stack([-np.sin(turn), np.cos(turn)], axis=-1)
    # (4, T, N - 1, 2) corners, in order around each box.
    corners = np.stack([centre + ahead + left, centre + ahead - left, centre - ahead - left, centre - ahead + left])
    step = np.roll(corners, -1, axis=0) - corners
    x, y = corners[..., 0], corners[..., 1]
    along = [np.where(np.abs(y) <= half_width, x, np.nan)]
    for side in (-half_width, half_width):
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (side - y) / step[..., 1]
            along.append(np.where((share >= 0.0) & (share <= 1.0), x + share * step[..., 0], np.nan))
    inside = np.concatenate(along) - half_length
    nearest = np.min(np.where(np.isnan(inside), np.inf, inside), axis=0)
    is_ahead = np.max(np.where(np.isnan(inside), -np.inf, inside), axis=0) > 0.0
    gaps = np.where(is_ahead & log.present[:, 1:], np.maximum(nearest, 0.0), np.inf)
    gap = np.min(gaps, axis=1, initial=np.inf)
    return np.where(gap <= farthest_m, gap, np.nan)
