"""References of the safety metrics in float64, made with shapely and plain numpy: slow, and independent of ours."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from mirror.arrays import Float64
from mirror.metrics.safety import StateLog
from mirror.schema.road_map import RoadMap


def boxes(log: StateLog, actor: int, ahead_s: float = 0.0, *, along_heading: bool = False) -> npt.NDArray[np.object_]:
    """Return the polygons (T,) of an actor, some time later at its velocity, or along its heading at its speed."""
    cos, sin = np.cos(log.yaw_rad[:, actor]), np.sin(log.yaw_rad[:, actor])
    velocity = np.stack([log.vx_mps[:, actor], log.vy_mps[:, actor]], axis=1)
    if along_heading:
        velocity = np.hypot(*velocity.T)[:, None] * np.stack([cos, sin], axis=1)
    center = np.stack([log.x_m[:, actor], log.y_m[:, actor]], axis=1) + ahead_s * velocity
    half = 0.5 * np.array([log.length_m[actor], log.width_m[actor]])
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * half
    corners = np.stack(
        [
            center[:, :1] + cos[:, None] * signs[:, 0] - sin[:, None] * signs[:, 1],
            center[:, 1:] + sin[:, None] * signs[:, 0] + cos[:, None] * signs[:, 1],
        ],
        axis=2,
    )
    return np.asarray(shapely.polygons(corners))


def first_contacts(log: StateLog) -> dict[str, float]:
    """Return the time in seconds of the first stamp at which each agent touches the ego."""
    own = boxes(log, 0)
    found = {}
    for actor in range(1, len(log.ids)):
        touching = np.flatnonzero(shapely.intersects(own, boxes(log, actor)))
        if len(touching):
            found[log.ids[actor]] = float(log.times_s[touching[0]])
    return found


def time_to_collision(log: StateLog, horizon_s: float, step_s: float, *, along_heading: bool = False) -> Float64:
    """Find the first multiple (T,) of a step at which the ego touches an agent at constant velocity; inf: none."""
    found = np.full(len(log.stamps_ns), math.inf)
    steps = np.arange(0.0, horizon_s + 1e-9, step_s)
    reach = 0.5 * np.hypot(log.length_m, log.width_m)
    for actor in range(1, len(log.ids)):
        away = np.hypot(log.x_m[:, actor] - log.x_m[:, 0], log.y_m[:, actor] - log.y_m[:, 0]) - reach[0] - reach[actor]
        closing = np.hypot(log.vx_mps[:, actor], log.vy_mps[:, actor]) + np.hypot(log.vx_mps[:, 0], log.vy_mps[:, 0])
        if (away > closing * horizon_s).all():
            continue
        for step in steps:
            touching = shapely.intersects(
                boxes(log, 0, step, along_heading=along_heading), boxes(log, actor, step, along_heading=along_heading)
            )
            found[touching] = np.minimum(found[touching], step)
    return found


def gap_at_contact(log: StateLog, ttc: Float64, steps: int = 40) -> float:
    """Check times to collision (T, N): the boxes are apart before the contact, and touch at it.

    Returns:
        The largest distance of two boxes at their contact; inf if boxes touch before it.
    """
    worst = 0.0
    for actor in range(1, len(log.ids)):
        for row in np.flatnonzero(np.isfinite(ttc[:, actor])).tolist():
            one = replace(log, **_row(log, row))
            contact = ttc[row, actor]
            touching = [
                shapely.distance(boxes(one, 0, ahead)[0], boxes(one, actor, ahead)[0])
                for ahead in (contact, *np.linspace(0.0, contact - 1e-6, steps))
            ]
            if contact > 1e-6 and min(touching[1:]) == 0.0:
                return math.inf
            worst = max(worst, float(touching[0]))
    return worst


def _row(log: StateLog, row: int) -> dict[str, Any]:
    columns = ("stamps_ns", "x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps", "present", "signal_states")
    values = {name: getattr(log, name) for name in columns}
    return {name: None if value is None else value[row : row + 1] for name, value in values.items()}


def drivable_margin(log: StateLog, road_map: RoadMap) -> Float64:
    """Return the signed distance (T,) of the ego's worst corner from the edge of the drivable area."""
    area = shapely.union_all([shapely.Polygon(part.rings[0], part.rings[1:]) for part in road_map.drivable])
    corners = shapely.points(shapely.get_coordinates(boxes(log, 0)).reshape(-1, 5, 2)[:, :4])
    signs = np.where(shapely.contains(area, corners), 1.0, -1.0)
    return np.asarray((signs * shapely.distance(area.boundary, corners)).min(axis=1))


def lane_offsets(log: StateLog, road_map: RoadMap) -> Float64:
    """Return the distances (T, L) of the ego's centre from the middles of driving lanes; NaN outside a lane."""
    centers = shapely.points(np.stack([log.x_m[:, 0], log.y_m[:, 0]], axis=1))
    columns = []
    for lane in road_map.lanes_of():
        line = shapely.LineString(lane.center_m[:, :2])
        away, along = shapely.distance(line, centers), shapely.line_locate_point(line, centers)
        inside = (away <= 0.5 * lane.width_m[0]) & (along > 0.0) & (along < line.length)
        columns.append(np.where(inside, away, np.nan))
    return np.stack(columns, axis=1)
