"""Maps for the tests of safety: straight lanes made by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mirror.metrics.safety.state_log import StateLog
from mirror.schema.road_map import MapArea, MapLane, MapSignal, RoadMap


def lane(lane_id: str, begin: Sequence[float], end: Sequence[float], width_m: float = 3.5, **more: object) -> MapLane:
    """A straight lane from one point to another."""
    points = np.linspace([*begin, 0.0], [*end, 0.0], 21)
    return MapLane(lane_id, more.pop("kind", "drive"), points, np.full(21, width_m), **more)


def rectangle_area(x: tuple[float, float], y: tuple[float, float]) -> MapArea:
    """A rectangular drivable area."""
    return MapArea("all", (np.array([[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]]),))


def two_way_street(**more: object) -> RoadMap:
    """A street along x: two lanes east at y = 0 and -3.5, one lane west at y = 3.5, with a signal at x = 100."""
    lanes = (
        lane("east", (-50.0, 0.0), (101.0, 0.0), left=None, right="slow", signal="s", stop_m=150.0),
        lane("slow", (-50.0, -3.5), (101.0, -3.5), left="east"),
        lane("west", (101.0, 3.5), (-50.0, 3.5)),
        lane("through", (101.0, 0.0), (130.0, 0.0), kind="turn"),
    )
    return RoadMap(
        scene_id="street",
        frame=None,
        fitted=False,
        lanes={one.lane_id: one for one in lanes},
        drivable=(more.pop("area", rectangle_area((-60.0, 140.0), (-5.25, 5.25))),),
        signals={"s": MapSignal("s", (("green", 10.0), ("amber", 3.0), ("red", 17.0)))},
    )


def moved_map(road_map: RoadMap, x_m: float, y_m: float, turn_rad: float) -> RoadMap:
    """The map in another frame."""
    from dataclasses import replace

    turn = np.array([[np.cos(turn_rad), np.sin(turn_rad)], [-np.sin(turn_rad), np.cos(turn_rad)]])

    def at(points: np.ndarray) -> np.ndarray:
        return np.column_stack([points[:, :2] @ turn + [x_m, y_m], points[:, 2:]])

    return replace(
        road_map,
        lanes={name: replace(one, center_m=at(one.center_m)) for name, one in road_map.lanes.items()},
        drivable=tuple(MapArea(one.area_id, tuple(at(ring) for ring in one.rings)) for one in road_map.drivable),
    )


def with_signal(log: StateLog, states: Sequence[int]) -> StateLog:
    """The log with the states of signal ``s``."""
    from dataclasses import replace

    return replace(log, signals=("s",), signal_states=np.array(states, np.int8)[:, None])
