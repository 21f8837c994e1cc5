"""Maps fitted to driven lines."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.dataset.fitted_map import MARGIN_M, VEHICLE_WIDTH_M, WIDTH_M, fit_road_map
from mirror.errors import UsageError
from mirror.metrics.safety import drivable_area_compliance, locate_on_lanes
from mirror.schema.road_map import encode_road_map
from tests.draws import draws
from tests.metrics.safety.logs import constant, state_log


def line(begin: tuple[float, float], end: tuple[float, float], count: int = 120) -> np.ndarray:
    return np.linspace([*begin, 0.0], [*end, 1.0], count)


def test_lines_beside_each_other_are_one_lane_in_their_mean() -> None:
    offsets = (-0.6, 0.0, 0.3)
    road_map = fit_road_map("street", None, [line((0, y), (100, y)) for y in offsets])
    assert road_map.fitted
    assert road_map.margin_m == 0.5 * WIDTH_M + MARGIN_M
    (lane,) = road_map.lanes.values()
    inner = lane.center_m[10:-10]
    np.testing.assert_allclose(inner[:, 1], np.mean(offsets), atol=1e-9)
    np.testing.assert_allclose(lane.width_m, max(WIDTH_M, 2 * 0.5 + VEHICLE_WIDTH_M), atol=0.05)
    (part,) = road_map.drivable
    low, high = part.rings[0][:, 1].min(), part.rings[0][:, 1].max()
    assert (low, high) == pytest.approx((-0.6 - road_map.margin_m, 0.3 + road_map.margin_m))


def test_opposite_directions_and_distant_lines_are_lanes_of_their_own() -> None:
    lines = [line((0, 0), (100, 0)), line((100, 1.0), (0, 1.0)), line((0, 3.5), (100, 3.5))]
    assert len(fit_road_map("street", None, lines).lanes) == 3


def test_a_lane_is_cut_where_another_leaves_it_and_joins_it() -> None:
    # A detour of the second line leaves the first at x = 30 and returns at x = 70.
    x = np.linspace(0.0, 100.0, 401)
    y = np.where((x > 30.0) & (x < 70.0), 8.0 * np.sin(np.pi * (x - 30.0) / 40.0) ** 2, 0.0)
    straight, detour = line((0, 0), (100, 0), 401), np.column_stack([x, y, 0.0 * x])
    road_map = fit_road_map("street", None, [straight, detour])
    lanes = road_map.lanes
    # The longer line is the detour; the straight one leaves it and joins it.
    assert len(lanes) == 4
    (first,) = [one for one in lanes.values() if not one.predecessors]
    assert len(first.successors) == 2
    after = {lanes[name].successors for name in first.successors}
    assert len(after) == 1
    (last,) = next(iter(after))
    assert lanes[last].successors == ()
    assert set(lanes[last].predecessors) == set(first.successors)
    for name in first.successors:
        gap = np.linalg.norm(lanes[name].center_m[0, :2] - first.center_m[-1, :2])
        assert gap < 2.0


def test_the_vehicle_that_drove_is_inside_its_map() -> None:
    times = 0.1 * np.arange(101)
    heading = 0.02 * times
    points = np.column_stack([np.cumsum(np.cos(heading)), np.cumsum(np.sin(heading)), 0 * times])
    road_map = fit_road_map("street", None, [points])
    log = state_log(times, constant(*points[50, :2], heading[50], 0.0, times))
    assert drivable_area_compliance(log, road_map.drivable_rings, tolerance_m=0.0).is_compliant
    assert (locate_on_lanes(log, road_map).corners_inside == 4).any()
    encode_road_map(road_map)


def test_standstills_and_repeated_points_do_not_matter() -> None:
    points = line((0, 0), (100, 0))
    standing = np.concatenate([points[:40], np.repeat(points[40:41], 500, axis=0), points[40:]])
    one, other = (fit_road_map("street", None, [lines]) for lines in (points, standing))
    np.testing.assert_allclose(one.lanes["driven-0.0"].center_m, other.lanes["driven-0.0"].center_m, atol=1e-9)


@settings(max_examples=draws(25), deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_all_driven_places_are_drivable_and_lanes_are_linked_both_ways(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lines = []
    for _ in range(5):
        heading = rng.uniform(-np.pi, np.pi) + np.cumsum(rng.normal(0.0, 0.03, 80))
        start = rng.uniform(-20, 20, 2)
        points = start + np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
        lines.append(np.column_stack([points, np.zeros(80)]))
    road_map = fit_road_map("street", None, lines)
    area = shapely.union_all([shapely.Polygon(part.rings[0], part.rings[1:]) for part in road_map.drivable])
    assert shapely.contains(area, shapely.points(np.concatenate(lines)[:, :2])).mean() > 0.97
    for name, one in road_map.lanes.items():
        assert all(name in road_map.lanes[after].predecessors for after in one.successors)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "no driven line"),
        ([line((0, 0), (5, 0))], "no driven line"),
        ([np.zeros((50, 3))], "no driven line"),
        ([np.full((50, 3), np.nan)], "a driven line of shape"),
        ([np.zeros((50, 2))], "a driven line of shape"),
    ],
)
def test_bad_lines_are_refused(lines: list[np.ndarray], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        fit_road_map("street", None, lines)
    with pytest.raises(UsageError, match="a width of"):
        fit_road_map("street", None, [line((0, 0), (100, 0))], margin_m=-1.0)
