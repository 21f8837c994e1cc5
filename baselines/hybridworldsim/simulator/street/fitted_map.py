"""A road map that is fitted to recordings: driven lines are lanes, and what lies near them is drivable."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import shapely

from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.schema.road_map import MapArea, MapLane, RoadMap

WIDTH_M: Final = 3.25
"""Width of a fitted lane."""
MARGIN_M: Final = 1.0
"""How far the drivable area reaches beyond the lanes."""
_STEP_M: Final = 1.0
_SAME_M: Final = 1.8
_SAME_COS: Final = 0.9
_SHARE: Final = 0.6


def fit_road_map(scene_id: str, frame: str | None, lines: Sequence[Float64]) -> RoadMap:
    """Fit a map to driven lines.

    Lines that run beside each other in the same direction for most of their length are one lane: the longest of them.

    Args:
        scene_id: the scene.
        frame: name of its local metric frame; None: that of its ROI.
        lines: driven lines (N, 3) in the scene's frame.

    Raises:
        UsageError: no line is longer than ten metres.
    """
    resampled = [line for line in (_resample(line) for line in lines) if len(line) > 10]
    if not resampled:
        raise UsageError("no driven line is longer than 10 m", place=scene_id, expected="a traversal that moves")
    kept: list[Float64] = []
    for line in sorted(resampled, key=len, reverse=True):
        if not any(_runs_along(line, other) for other in kept):
            kept.append(line)
    lanes = {
        f"driven-{number}": MapLane(f"driven-{number}", "drive", line, np.full(len(line), WIDTH_M))
        for number, line in enumerate(kept)
    }
    reach = 0.5 * WIDTH_M + MARGIN_M
    area = shapely.union_all([shapely.LineString(line[:, :2]).buffer(reach) for line in resampled])
    parts = tuple(
        MapArea(
            f"corridor-{number}",
            tuple(shapely.get_coordinates(ring)[:-1] for ring in (part.exterior, *part.interiors)),
        )
        for number, part in enumerate(shapely.get_parts(area))
    )
    return RoadMap(scene_id, frame, True, lanes, parts, margin_m=reach)


def _resample(line: Float64) -> Float64:
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T))])
    # A standing vehicle gives many places at one length.
    moving = np.concatenate([[True], np.diff(along) > 1e-3])
    even = np.arange(0.0, along[-1], _STEP_M)
    return np.column_stack([np.interp(even, along[moving], line[moving, axis]) for axis in range(3)])


def _runs_along(line: Float64, other: Float64) -> bool:
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(other[:, :2]).query(line[:, :2])
    ahead, other_ahead = (np.gradient(points[:, :2], axis=0) for points in (line, other))
    along = (ahead * other_ahead[nearest]).sum(axis=1)
    scale = np.linalg.norm(ahead, axis=1) * np.linalg.norm(other_ahead[nearest], axis=1)
    return bool(((distance < _SAME_M) & (along > _SAME_COS * scale)).mean() > _SHARE)
