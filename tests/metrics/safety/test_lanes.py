"""The ego on lanes: against shapely, and on hand-made cases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from mirror.errors import UsageError
from mirror.metrics.safety import find_red_lights, locate_on_lanes, score_rollout
from mirror.metrics.safety.lanes import driven_while, ego_points, lanes_of_route
from mirror.schema.road_map import MapLane, RoadMap
from tests.metrics.safety.logs import Actor, constant, moved, random_log, state_log
from tests.metrics.safety.streets import lane, moved_map, rectangle_area, two_way_street, with_signal

TIMES = 0.1 * np.arange(51)
GREEN, AMBER, RED, RED_AMBER = range(4)


def curved_map(rng: np.random.Generator) -> RoadMap:
    lanes = {}
    for number in range(5):
        along = np.linspace(0.0, 40.0, 60)
        heading = rng.uniform(-np.pi, np.pi) + rng.uniform(-0.04, 0.04) * along
        line = rng.uniform(-15, 15, 2) + np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0) * 0.7
        name = f"lane{number}"
        lanes[name] = MapLane(name, "drive", np.column_stack([line, along]), np.full(60, rng.uniform(2.5, 4.5)))
    return RoadMap("street", None, False, lanes, (rectangle_area((-99, 99), (-99, 99)),))


@pytest.mark.parametrize("seed", range(8))
def test_lanes_contain_what_buffers_of_their_lines_contain(seed: int) -> None:
    rng = np.random.default_rng(seed)
    road_map, log = curved_map(rng), random_log(rng, agents=0, stamps=40)
    found = locate_on_lanes(log, road_map)
    points = ego_points(log)
    for column, one in enumerate(found.lanes):
        line = shapely.LineString(one.center_m[:, :2])
        places = shapely.points(points)
        foot = shapely.line_locate_point(line, places)
        near = shapely.distance(line, places)
        inside = (near <= 0.5 * one.width_m[0]) & (foot > 1e-9) & (foot < line.length - 1e-9)
        np.testing.assert_array_equal(found.corners_inside[:, column], inside[:, :4].sum(axis=1))
        own = inside[:, 4]
        np.testing.assert_array_equal(~np.isnan(found.center_offset_m[:, column]), own)
        np.testing.assert_allclose(np.abs(found.center_offset_m[own, column]), near[own, 4], atol=1e-9)
        np.testing.assert_allclose(found.center_along_m[own, column], foot[own, 4], atol=1e-9)
        # A point on the left of the line is counter-clockwise of it.
        for row in np.flatnonzero(own):
            after = line.interpolate(foot[row, 4] + 1e-4)
            here = line.interpolate(foot[row, 4])
            cross = (after.x - here.x) * (points[row, 4, 1] - here.y) - (after.y - here.y) * (
                points[row, 4, 0] - here.x
            )
            assert np.sign(cross) == np.sign(found.center_offset_m[row, column]) or abs(cross) < 1e-9


def test_between_lanes_in_a_junction_and_oncoming() -> None:
    road_map = two_way_street()
    for y, yaw, between, oncoming in (
        (0.0, 0.0, False, False),
        (-1.75, 0.0, True, False),
        (3.5, 0.0, False, True),
        (3.5, np.pi, False, False),
        (1.75, 0.0, True, False),
        (2.0, 0.0, True, True),
    ):
        found = locate_on_lanes(state_log(TIMES, constant(0.0, y, yaw, 1.0, TIMES)), road_map)
        assert (found.between_lanes.all(), found.between_lanes.any()) == (between, between), y
        assert (found.is_oncoming.all(), found.is_oncoming.any()) == (oncoming, oncoming), y
    # A lane of a junction that runs against the ego over the oncoming lane: no lane is oncoming there.
    turn = lane("turn", (30.0, 3.5), (-30.0, 3.5), kind="turn")
    crossed = replace(road_map, lanes={**road_map.lanes, "turn": turn})
    assert not locate_on_lanes(state_log(TIMES, constant(0.0, 3.5, 0.0, 1.0, TIMES)), crossed).is_oncoming.any()
    # The rear axle is 1.4 m behind the centre and enters the junction at x = 101.
    found = locate_on_lanes(state_log(TIMES, constant(92.4, 0.0, 0.0, 10.0, TIMES)), road_map)
    np.testing.assert_array_equal(found.in_junction, (91.0 + 10.0 * TIMES >= 101.0 - 1e-9) & (91 + 10 * TIMES <= 130.0))


def test_distances_off_road_and_in_the_wrong_lane() -> None:
    # 5 s at 4 m/s; the ego changes to the oncoming lane at y = 3.5 for two seconds.
    y = np.where((TIMES > 1.0) & (TIMES <= 3.0), 3.5, 0.0)
    ego = Actor(np.stack([4.0 * TIMES, y, 0 * y, np.full_like(y, 4.0), 0 * y], axis=1))
    log = state_log(TIMES, ego)
    report = score_rollout(with_signal(log, [GREEN] * 51), two_way_street())
    jumps = np.hypot(0.4, 3.5)
    # Nineteen steps inside, and half of the two jumps.
    assert report.figures["wrong_lane"].value == pytest.approx(19 * 0.4 + jumps)
    assert report.figures["wrong_lane"].cause == "ego"
    assert report.figures["off_road"].value == 0.0
    narrow = two_way_street(area=rectangle_area((-60.0, 140.0), (-5.25, 3.0)))
    report = score_rollout(with_signal(log, [GREEN] * 51), narrow)
    assert report.figures["off_road"].value == pytest.approx(19 * 0.4 + jumps)
    assert report.figures["drivable_margin"].value == pytest.approx(3.0 - 3.5 - 0.9)
    assert driven_while(log, np.zeros(51, bool)) == 0.0


@pytest.mark.parametrize("speed", [0.5, 10.0, 45.0])
def test_a_red_light_counts_when_the_front_passes_the_stop_line(speed: float) -> None:
    road_map = two_way_street()
    # The front (2.25 m ahead) is at the line, x = 100, after 2.03 s.
    log = state_log(TIMES, constant(97.75 - 2.03 * speed, 0.0, 0.0, speed, TIMES))
    passed = np.searchsorted(TIMES, 2.03) - 1
    for before, after, count in ((RED, GREEN, 1), (GREEN, RED, 0), (AMBER, RED, 0), (RED_AMBER, GREEN, 1)):
        states = [before if row <= passed else after for row in range(51)]
        found = find_red_lights(with_signal(log, states), road_map)
        assert len(found) == count
        for one in found:
            assert (one.signal, one.lane) == ("s", "east")
            assert one.stamp_ns - int(log.stamps_ns[0]) == pytest.approx(2.03e9, abs=2)


def test_no_red_light_for_other_lanes_directions_and_stops() -> None:
    road_map, red = two_way_street(), [RED] * 51
    for ego in (
        constant(90.0, -3.5, 0.0, 10.0, TIMES),  # a lane without a signal
        constant(110.0, 0.0, np.pi, 10.0, TIMES),  # against the lane
        constant(90.0, 0.0, 0.0, 1.5, TIMES),  # stops before the line
        constant(99.0, 0.0, 0.0, 5.0, TIMES),  # begins beyond the line
    ):
        assert find_red_lights(with_signal(state_log(TIMES, ego), red), road_map) == ()


def test_a_log_without_the_signal_has_no_red_lights_figure() -> None:
    log = state_log(TIMES, constant(0.0, 0.0, 0.0, 10.0, TIMES))
    with pytest.raises(UsageError, match="no states of signal 's'"):
        find_red_lights(log, two_way_street())
    figure = score_rollout(log, two_way_street()).figures["red_lights"]
    assert not figure.is_valid
    assert np.isnan(figure.value)
    assert "signal 's'" in figure.reason


def test_the_route_selects_lanes_of_its_direction() -> None:
    road_map = two_way_street()
    route = np.stack([np.linspace(-40, 120, 100), np.zeros(100)], axis=1)
    names = [one.lane_id for one in road_map.lanes_of()]
    chosen = {name for name, on in zip(names, lanes_of_route(route, road_map)) if on}
    assert chosen == {"east", "through"}
    assert not lanes_of_route(route[::-1], road_map).any()


@pytest.mark.parametrize("seed", range(5))
def test_the_frame_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    road_map, log = curved_map(rng), random_log(rng, agents=0, stamps=20)
    found, other = (
        locate_on_lanes(log, road_map),
        locate_on_lanes(moved(log, 4e6, -5e6, 0.7), moved_map(road_map, 4e6, -5e6, 0.7)),
    )
    np.testing.assert_array_equal(found.corners_inside, other.corners_inside)
    np.testing.assert_allclose(found.center_offset_m, other.center_offset_m, atol=1e-6)
    np.testing.assert_allclose(found.turned_rad, other.turned_rad, atol=1e-6)


def test_a_map_without_driving_lanes() -> None:
    empty = RoadMap("street", None, True, {}, (rectangle_area((-9, 99), (-9, 9)),))
    found = locate_on_lanes(state_log(TIMES, constant(0, 0, 0, 1.0, TIMES)), empty)
    assert not found.between_lanes.any()
    assert not found.is_oncoming.any()
    assert found.corners_inside.shape == (51, 0)
