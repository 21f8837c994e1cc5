"""A road map of the street of `tests.builders.folder`."""

from __future__ import annotations

import numpy as np

from mirror.schema.road_map import MapArea, MapLane, RoadMap


def east_map(scene_id: str = "street", *, aside_m: float = 0.0, frame: str | None = None) -> RoadMap:
    """A road along x, 8 m wide, with one lane in its middle."""
    x = np.linspace(-150.0, 150.0, 31)
    center = np.column_stack([x, np.full_like(x, aside_m), np.zeros_like(x)])
    ring = np.array([[-150.0, -4.0], [150.0, -4.0], [150.0, 4.0], [-150.0, 4.0]]) + np.array([0.0, aside_m])
    lane = MapLane("only", "drive", center, np.full_like(x, 3.5))
    return RoadMap(scene_id, frame, False, {"only": lane}, (MapArea("road", (ring,)),))
