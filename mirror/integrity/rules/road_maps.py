"""Rules of MAP: recorded road maps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import shapely

from mirror.dataset.layout import MAPS
from mirror.dataset.recorded_map import MAP_FILE
from mirror.integrity.dataset_view import DatasetView
from mirror.integrity.finding import Finding, Severity
from mirror.integrity.problems import report_unreadable
from mirror.integrity.rule import dataset_rule, scene_rule
from mirror.integrity.scene_view import SceneView

_LEAST_SHARE: Final = 0.5


@dataset_rule(
    "MAP001",
    Severity.ERROR,
    title="A road map is broken, of another scene or in another frame, or lies elsewhere.",
    remedy="add the right map: `mirror ingest --map FILE --replace --out DATASET`",
)
def _road_map(view: DatasetView) -> Iterator[Finding]:
    _ = view.road_maps
    yield from report_unreadable(view.problems, lambda file: file.startswith(f"{MAPS}/") and file.endswith(MAP_FILE))


@scene_rule(
    "MAP002",
    Severity.WARNING,
    title="Less than half of a scene's driven positions lie on the drivable area of its road map.",
    remedy="the map may be of another place, or in other coordinates: add the right one with `mirror ingest --map FILE"
    " --replace`",
)
def _driven_area(view: SceneView) -> Iterator[Finding]:
    if view.road_map is None or not len(view.poses):
        return
    area = shapely.union_all([shapely.Polygon(part.rings[0], part.rings[1:]) for part in view.road_map.drivable])
    x, y = view.poses.floats("tx_m"), view.poses.floats("ty_m")
    roi = view.scene
    inside = np.hypot(x - (roi.x_m or 0.0), y - (roi.y_m or 0.0)) <= roi.radius_m
    if not inside.any():
        return
    share = float(shapely.contains_xy(area, x[inside], y[inside]).mean())
    if share < _LEAST_SHARE:
        yield Finding(
            f"{MAPS}/{roi.scene_id}/{MAP_FILE}",
            None,
            f"{share:.0%} of {inside.sum():,} positions in the region of interest lie on the drivable area",
        )
