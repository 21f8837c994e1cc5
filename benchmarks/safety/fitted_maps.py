"""How near maps that are fitted to driven lines come to the exact map of the street."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import shapely

from benchmarks.report import Row
from mirror.arrays import Float64
from mirror.dataset.fitted_map import fit_road_map
from mirror.schema.road_map import DRIVING, RoadMap
from mirror.synth.fleet.drives import make_drives
from mirror.synth.maps import street_map

_NOISE_M = 0.3
_STEP_M = 2.0


def rows(preset: str, seed: int) -> Iterator[Row]:
    """Yield the rows for the first scene of a preset, from exact driven lines and from noisy ones."""
    _, drives = make_drives(preset, seed, scenes=1)
    exact = street_map(drives[0].world.plan)
    lines = []
    for drive in drives:
        times = np.arange(0.0, drive.truth.duration_s, 0.1)
        points = drive.truth.poses(times).translation
        lines.append(points[np.hypot(points[:, 0], points[:, 1]) < drive.roi.radius_m])
    rng = np.random.default_rng(seed)
    # The error of a fix changes slowly: one offset a drive.
    noisy = [line + np.append(rng.normal(0.0, _NOISE_M, 2), 0.0) for line in lines]
    for name, driven in (("exact", lines), (f"{_NOISE_M} m noise", noisy)):
        start = time.perf_counter()
        fitted = fit_road_map(exact.scene_id, None, driven)
        took = (time.perf_counter() - start) * 1e3
        size = f"{len(driven)} drives, {len(fitted.lanes)} lanes"
        middle = _distances(fitted, exact)
        yield Row(f"lanes, median, {name}", size, took, float(np.median(middle)), unit="m")
        yield Row(f"lanes, 95 %, {name}", size, took, float(np.percentile(middle, 95)), unit="m")
        own, area = _area(fitted), _area(exact)
        outside = own.difference(area).area / own.area
        yield Row(f"area not drivable, {name}", size, took, 100.0 * outside, unit="%")
        edge = shapely.points(_boundary_points(own))
        depth = np.where(shapely.contains(area, edge), 0.0, shapely.distance(area, edge))
        yield Row(f"edge beyond, largest, {name}", size, took, float(depth.max()), unit="m")


def _distances(fitted: RoadMap, exact: RoadMap) -> Float64:
    """Distances of the middles of fitted lanes from the nearest exact one."""
    lines = shapely.STRtree([shapely.LineString(lane.center_m[:, :2]) for lane in exact.lanes_of(DRIVING)])
    points = shapely.points(np.concatenate([lane.center_m[:, :2] for lane in fitted.lanes.values()]))
    pairs = lines.nearest(points)
    return np.asarray(shapely.distance(points, lines.geometries[pairs]))


def _area(road_map: RoadMap) -> shapely.Geometry:
    return shapely.union_all([shapely.Polygon(part.rings[0], part.rings[1:]) for part in road_map.drivable])


def _boundary_points(area: shapely.Geometry) -> Float64:
    rings = shapely.get_parts(area.boundary)
    points = [shapely.line_interpolate_point(ring, np.arange(0.0, ring.length, _STEP_M)) for ring in rings]
    return np.asarray(shapely.get_coordinates(np.concatenate(points)))
