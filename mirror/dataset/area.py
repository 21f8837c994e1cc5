"""The area of the ground that scenes cover."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from mirror.arrays import Float64
from mirror.dataset.splits.leaks import overlapping_scenes
from mirror.dataset.splits.units import connected_components, members_by_component
from mirror.geometry.geodesy import geodesic_circle
from mirror.schema.documents import Roi

_VERTICES: Final = 720
# A polygon with its corners on a circle has a smaller area. With this factor on the radius both areas are equal.
_RADIUS_FACTOR: Final = math.sqrt((2 * math.pi / _VERTICES) / math.sin(2 * math.pi / _VERTICES))


def covered_area_m2(scenes: Sequence[Roi]) -> float:
    """Compute the area in m² of the union of circles, on the ellipsoid or in the planes of local metric frames.

    A circle without overlap counts as ``pi r^2``; curvature of the ellipsoid reduces it by 2e-9 at a radius of 1 km
    and by 8e-7 at 20 km. Overlapping circles are united as polygons with 720 corners in an equal-area projection
    (PROJ's ``laea``).

    Args:
        scenes: regions of interest with unique ids.
    """
    by_id = {roi.scene_id: roi for roi in scenes}
    pairs = [(first.scene_id, second.scene_id) for first, second, _ in overlapping_scenes(scenes)]
    total = 0.0
    for members in members_by_component(connected_components(by_id, pairs)).values():
        rois = [by_id[name] for name in members]
        total += math.pi * rois[0].radius_m ** 2 if len(rois) == 1 else _union_m2(rois)
    return total


def _union_m2(scenes: Sequence[Roi]) -> float:
    from shapely import Polygon, union_all

    return float(union_all([Polygon(_ring(roi, scenes[0])) for roi in scenes]).area)


def _ring(roi: Roi, origin: Roi) -> Float64:
    """Corners (720, 2) of a circle in metres, in its local frame or in the equal-area projection at an origin."""
    radius = roi.radius_m * _RADIUS_FACTOR
    if roi.longitude_deg is None or roi.latitude_deg is None:
        angle = np.linspace(0.0, 2 * math.pi, _VERTICES, endpoint=False)
        return np.column_stack([(roi.x_m or 0.0) + radius * np.cos(angle), (roi.y_m or 0.0) + radius * np.sin(angle)])
    import pyproj

    ring = geodesic_circle(roi.longitude_deg, roi.latitude_deg, radius, _VERTICES)[:-1]
    plane = pyproj.Proj(proj="laea", lon_0=origin.longitude_deg, lat_0=origin.latitude_deg, datum="WGS84")
    return np.column_stack(plane(ring[:, 0], ring[:, 1]))
