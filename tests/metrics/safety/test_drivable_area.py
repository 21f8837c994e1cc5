"""The drivable area against shapely."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from mirror.errors import UsageError
from mirror.metrics.safety import drivable_area_compliance, inside_area
from mirror.metrics.safety.state_log import StateLog
from tests.metrics.safety.logs import Actor, constant, moved, random_log, rectangle, state_log

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
    assert found.least_margin_m <= found.margin_m.min()


def finer(log: StateLog, parts: int) -> StateLog:
    """The same motion with more stamps: position and heading change linearly between those of the log."""
    rows = np.arange(parts * (len(log.stamps_ns) - 1) + 1) / parts
    actor = {
        name: np.interp(rows, np.arange(len(log.stamps_ns)), np.unwrap(getattr(log, name)[:, 0]))
        for name in ("x_m", "y_m", "yaw_rad")
    }
    times = np.interp(rows, np.arange(len(log.stamps_ns)), log.times_s)
    states = np.stack([*actor.values(), np.zeros(len(rows)), np.zeros(len(rows))], axis=1)
    return state_log(times, Actor(states, float(log.length_m[0]), float(log.width_m[0])))


@pytest.mark.parametrize("seed", range(30))
def test_the_least_margin_is_that_of_a_thousand_times_as_many_stamps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    log = random_log(rng, agents=0)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 12))
    outline = rng.uniform(8, 30, (12, 1)) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    hole = 1.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    found = drivable_area_compliance(log, [outline, hole])
    fine = drivable_area_compliance(finer(log, 1000), [outline, hole]).margin_m
    # 5 mm are the way of a corner between two of the fine stamps.
    assert found.least_margin_m == pytest.approx(fine.min(), abs=6e-3)
    when = (found.stamp_ns - log.stamps_ns[0]) * 1e-9 / (log.times_s[-1] - log.times_s[0]) * (len(fine) - 1)
    assert fine[round(when)] == pytest.approx(found.least_margin_m, abs=2e-2)


def test_a_post_between_two_stamps_is_not_passed_over() -> None:
    times = 0.1 * np.arange(4)
    log = state_log(times, constant(0.0, 0.0, 0.0, 40.0, times))
    post = np.array([[0.0, 0.8], [0.2, 0.8], [0.2, 1.0], [0.0, 1.0]]) + np.array([4.0, 0.0])
    found = drivable_area_compliance(log, [ROAD, post])
    assert found.margin_m.min() > 0.5
    assert found.least_margin_m == pytest.approx(-0.1, abs=1e-3)
    assert not drivable_area_compliance(log, [ROAD, post], tolerance_m=0.05).is_compliant
    near = drivable_area_compliance(log, [ROAD, post + np.array([0.0, 0.3])])
    assert near.least_margin_m == pytest.approx(0.2, abs=1e-9)
    corner_s = (4.0 + 0.0 - 0.5 * log.length_m[0]) / 40.0
    assert 0.0 < (near.stamp_ns - log.stamps_ns[0]) * 1e-9 - corner_s < 0.3


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


@pytest.mark.parametrize("seed", range(12))
def test_straight_paths_between_posts_have_the_distance_that_shapely_gives(seed: int) -> None:
    """Forty posts are several groups of segments; no coordinate is near 0; paths pass on every side of the posts."""
    rng = np.random.default_rng(seed)
    posts = [rng.uniform(100.0, 160.0, 2) + rng.uniform(0.05, 0.6, (3, 2)) for _ in range(40)]
    ring = np.array([[80.0, 80.0], [180.0, 80.0], [180.0, 180.0], [80.0, 180.0]])
    area = shapely.Polygon(ring).difference(shapely.union_all([shapely.Polygon(post) for post in posts]))
    begin, end = rng.uniform(100.0, 160.0, (2, 2))
    times = np.array([0.0, 1.0])
    states = np.column_stack([[begin, end], np.zeros((2, 3))])
    log = state_log(times, Actor(states, 1e-6, 1e-6))
    found = drivable_area_compliance(log, [ring, *posts]).least_margin_m
    way = shapely.LineString([begin, end])
    clear = way.distance(area.boundary)
    if clear > 0.0:
        assert found == pytest.approx(clear, abs=1e-5)
    else:
        inside = shapely.points(np.linspace(begin, end, 20_001))
        deepest = -shapely.distance(inside, area.boundary)[~shapely.contains(area, inside)].max(initial=0.0)
        assert found == pytest.approx(deepest, abs=6e-3)


def test_a_path_that_crosses_a_thin_wall_between_two_stamps_leaves_the_area() -> None:
    """Both ends are inside and far from the wall, which the path crosses at every slope."""
    ring = np.array([[80.0, 80.0], [180.0, 80.0], [180.0, 180.0], [80.0, 180.0]])
    for slope in np.linspace(-3.0, 3.0, 13):
        wall = np.array(
            [[129.99, 130.0 - 20.0], [130.01, 130.0 - 20.0], [130.01, 130.0 + 20.0], [129.99, 130.0 + 20.0]]
        )
        states = np.array([[125.0, 130.0 - 5.0 * slope, 0, 0, 0], [135.0, 130.0 + 5.0 * slope, 0, 0, 0]], np.float64)
        found = drivable_area_compliance(state_log(np.array([0.0, 1.0]), Actor(states, 1e-6, 1e-6)), [ring, wall])
        assert found.margin_m.min() > 4.0
        assert found.least_margin_m <= 1e-4, slope
