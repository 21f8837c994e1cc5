"""The exact map of a synthetic street."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from mirror.schema.road_map import RoadMap
from mirror.synth import street_map
from mirror.synth.fleet.places import GUANGZHOU_HIGHWAY, KARLSRUHE_CAMPUS, KARLSRUHE_RURAL, TORONTO_URBAN
from mirror.synth.street.plan import StreetPlan, plan_scene
from mirror.traffic.following.signals import Signal, signal_state


@pytest.fixture(scope="module", params=[TORONTO_URBAN, KARLSRUHE_RURAL, GUANGZHOU_HIGHWAY, KARLSRUHE_CAMPUS])
def plan(request: pytest.FixtureRequest) -> StreetPlan:
    return plan_scene(request.param, 20.0, 3)


@pytest.fixture(scope="module")
def road_map(plan: StreetPlan) -> RoadMap:
    return street_map(plan)


def area_of(road_map: RoadMap) -> shapely.Geometry:
    return shapely.union_all([shapely.Polygon(part.rings[0], part.rings[1:]) for part in road_map.drivable])


def test_the_drivable_area_is_that_of_the_carriageways(plan: StreetPlan, road_map: RoadMap) -> None:
    assert not road_map.fitted
    assert area_of(road_map).symmetric_difference(plan.carriageways).area < 1e-6


def test_lanes_are_linked_both_ways_and_join(road_map: RoadMap) -> None:
    for name, lane in road_map.lanes.items():
        for after in lane.successors:
            assert name in road_map.lanes[after].predecessors
            gap = road_map.lanes[after].center_m[0] - lane.center_m[-1]
            assert np.linalg.norm(gap[:2]) < 0.05
        for before in lane.predecessors:
            assert name in road_map.lanes[before].successors
        if lane.left is not None:
            assert road_map.lanes[lane.left].right == name


def test_driving_lanes_lie_on_the_carriageway_and_follow_the_ground(plan: StreetPlan, road_map: RoadMap) -> None:
    area = area_of(road_map).buffer(0.05)
    for lane in road_map.lanes_of():
        assert shapely.contains(area, shapely.points(lane.center_m[:, :2])).all(), lane.lane_id
        np.testing.assert_allclose(lane.center_m[:, 2], plan.height_m(*lane.center_m[:, :2].T), atol=1e-9)
    for lane in road_map.lanes_of({"drive"}):
        outline = shapely.Polygon(lane.outline_m)
        assert outline.difference(area).area < 0.01 * outline.area


def test_zebras_lie_under_the_crossing_lanes(road_map: RoadMap) -> None:
    zebras = shapely.union_all([shapely.Polygon(one.outline_m) for one in road_map.crossings])
    crossing = road_map.lanes_of({"cross"})
    assert bool(crossing) == bool(road_map.crossings)
    for lane in crossing:
        middle = lane.center_m[len(lane.center_m) // 2, :2]
        assert zebras.contains(shapely.Point(middle))


def test_signals_show_what_the_traffic_obeys(plan: StreetPlan, road_map: RoadMap) -> None:
    names = {Signal.GREEN: "green", Signal.AMBER: "amber", Signal.RED: "red", Signal.RED_AMBER: "red_amber"}
    for clock_s in np.arange(-70.0, 130.0, 0.73):
        shown = signal_state(plan.network, clock_s)
        assert [one.state_at(clock_s) for one in road_map.signals.values()] == [names[Signal(state)] for state in shown]
    controlled = [lane for lane in road_map.lanes.values() if lane.signal is not None]
    assert bool(controlled) == bool(road_map.signals)
    assert all(lane.stop_m is not None for lane in controlled if lane.kind == "drive")
