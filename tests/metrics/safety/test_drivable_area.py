"""The drivable area against shapely."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from mirror.errors import UsageError
from mirror.metrics.safety import drivable_area_compliance, inside_area
from tests.metrics.safety.logs import constant, moved, random_log, rectangle, state_log

TIMES = 0.1 * np.arange(21)
ROAD = [[-10.0, -3.0], [100.0, -3.0], [100.0, 3.0], [-10.0, 3.0]]


@pytest.mark.parametrize("seed", range(20))
def test_margins_are_the_distances_from_the_boundary(seed: int) -> None:
    rng = np.random.default_rng(seed)
    log = random_log(rng, agents=0)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 12))
    outline = rng.uniform(8, 20, (12, 1)) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    hole = 2.0 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    area = shapely.Polygon(outline).symmetric_difference(shapely.Polygon(hole))
    found = drivable_area_compliance(log, [outline, hole])
    for row, margin in enumerate(found.margin_m):
        box = rectangle(log.x_m[row, 0], log.y_m[row, 0], log.yaw_rad[row, 0], log.length_m[0], log.width_m[0])
        corners = shapely.points(shapely.get_coordinates(box)[:4])
        edges = shapely.union_all([shapely.LinearRing(outline), shapely.LinearRing(hole)])
        signs = np.where(shapely.contains(area, corners), 1.0, -1.0)
        assert margin == pytest.approx((signs * shapely.distance(corners, edges)).min(), abs=1e-9)
    assert found.least_margin_m == found.margin_m.min()
    assert found.stamp_ns == log.stamps_ns[np.argmin(found.margin_m)]


def test_the_tolerance_decides() -> None:
    for y, compliant in ((0.0, True), (2.399, True), (2.401, False), (-2.401, False)):
        log = state_log(TIMES, constant(0.0, y, 0.0, 10.0, TIMES))
        found = drivable_area_compliance(log, [ROAD])
        assert found.is_compliant is compliant
        assert found.least_margin_m == pytest.approx(3.0 - 0.9 - abs(y))
    assert not drivable_area_compliance(
        state_log(TIMES, constant(0.0, 2.2, 0.0, 1.0, TIMES)), [ROAD], tolerance_m=0.0
    ).is_compliant


def test_the_frame_does_not_matter() -> None:
    log = state_log(TIMES, constant(0.0, 0.0, 0.1, 10.0, TIMES))
    margins = drivable_area_compliance(log, [ROAD]).margin_m
    cos, sin = np.cos(0.7), np.sin(0.7)
    ring = np.array(ROAD) @ np.array([[cos, sin], [-sin, cos]]) + [4e6, -5e6]
    assert drivable_area_compliance(moved(log, 4e6, -5e6, 0.7), [ring]).margin_m == pytest.approx(margins, abs=1e-6)


def test_points() -> None:
    assert inside_area([[0.0, 0.0], [0.0, 3.1]], [ROAD]).tolist() == [True, False]
    assert inside_area(np.empty((0, 2)), [ROAD]).tolist() == []


@pytest.mark.parametrize("rings", [[], [[[0.0, 0.0], [1.0, 1.0]]], [[[0.0, 0.0], [1.0, 1.0], [np.nan, 0.0]]]])
def test_bad_areas_are_refused(rings: list[object]) -> None:
    with pytest.raises(UsageError, match="ring"):
        drivable_area_compliance(state_log(TIMES, constant(0, 0, 0, 1.0, TIMES)), rings)
    with pytest.raises(UsageError, match="tolerance_m"):
        drivable_area_compliance(state_log(TIMES, constant(0, 0, 0, 1.0, TIMES)), [ROAD], tolerance_m=-1.0)
