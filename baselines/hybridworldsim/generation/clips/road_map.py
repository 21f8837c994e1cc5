"""The lines of a road map that a generator is shown."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from hybridworldsim.generation.clips.map_lines import LineKind, MapLine
from mirror.arrays import Float64
from mirror.schema.road_map import LaneKind, MapLane, RoadMap

_KINDS: Final[tuple[LaneKind, ...]] = ("drive", "park", "cycle")
"""Lanes along a street. Those through junctions cross each other, and no marking shows them."""
_SPACING_M: Final = 2.0


def lines_of_map(road_map: RoadMap, driven_m: Float64) -> tuple[MapLine, ...]:
    """Return the borders of the drivable area and of lanes, and the crossings of a road map.

    Areas and crossings have no heights: their points get the height of the nearest middle line of a lane.

    Args:
        road_map: the map.
        driven_m: (P, 3) points on the ground in the map's frame, P at least 1; they give the heights of a map without
            lanes.

    Returns:
        Lines in the map's frame, with points at most 2 m apart on the ground plane.
    """
    lanes = [_dense(lane.center_m) for lane in road_map.lanes.values()]
    ground = np.concatenate(lanes) if lanes else driven_m
    rings: list[tuple[LineKind, Float64]] = [
        *(("drivable", ring) for ring in road_map.drivable_rings),
        *(("crossing", crossing.outline_m) for crossing in road_map.crossings),
    ]
    closed = [_dense(np.concatenate([ring, ring[:1]])) for _, ring in rings]
    return (
        *(MapLine(kind, _raised(points, ground)) for (kind, _), points in zip(rings, closed)),
        *(MapLine("lane", border) for lane in road_map.lanes_of(_KINDS) for border in _borders(lane)),
    )


def _borders(lane: MapLane) -> Iterator[Float64]:
    right, left = np.split(lane.outline_m, 2)
    for points in (right, left[::-1]):
        yield _dense(np.column_stack([points, lane.center_m[:, 2]]))


def _dense(points: Float64) -> Float64:
    """The same line with further points, so that none is more than `_SPACING_M` from the next one."""
    steps = np.diff(points, axis=0)
    counts = np.maximum(np.ceil(np.linalg.norm(steps, axis=1) / _SPACING_M), 1.0).astype(np.int64)
    share = np.concatenate([np.arange(count) / count for count in counts])
    begin = np.repeat(np.arange(len(steps)), counts)
    return np.concatenate([points[begin] + share[:, None] * steps[begin], points[-1:]])


def _raised(points: Float64, ground_m: Float64) -> Float64:
    """Points (P, 2) with the heights of the nearest points of the ground."""
    from scipy.spatial import KDTree

    _, nearest = KDTree(ground_m[:, :2]).query(points)
    return np.column_stack([points, ground_m[nearest, 2]])
