"""Tests of zones, signals and right of way in the traffic simulation."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity
from shapely.geometry import box

from mirror.traffic.following.participants import Manner, Participant, simulate_participants
from mirror.traffic.following.signals import Signal, signal_state
from mirror.traffic.following.zones import find_zones
from mirror.traffic.lanes.ways import Piece, build_way, follow_lanes
from mirror.traffic.placement.overlaps import select_non_overlapping
from mirror.traffic.placement.trace import Aside, Chassis, Schedule
from tests.draws import draws
from tests.traffic import street

NETWORK = street.network()
CAR = Chassis.of_box(4.5, 1.8)
EAST = follow_lanes(NETWORK, ("main+0", "main+0>main+1", "main+1", "main+1>main+2", "main+2"))
NORTH = follow_lanes(NETWORK, ("cross+0", "cross+0>cross+1", "cross+1"))
LEFT = follow_lanes(NETWORK, ("main+0", "main+0>main+1", "main+1", "main+1>cross+1", "cross+1"))
WEST = follow_lanes(NETWORK, ("main-0", "main-0>main-1", "main-1", "main-1>main-2", "main-2"))
ZEBRA = follow_lanes(NETWORK, ("walk11.0", "walk11.1", "walk11.2"))


def car(way, enter_s=0.0, enter_m=0.0, **more) -> Participant:
    return Participant("car", 0, way, CAR, Manner(1.0, 50.0, 1.6, 2.0, 1.3), Aside(), enter_s, enter_m, **more)


def run(*participants, clock_s=0.0, longest_s=90.0) -> list[Schedule]:
    schedules = simulate_participants(NETWORK, participants, clock_s, longest_s)
    assert all(schedule is not None for schedule in schedules)
    return schedules


def test_crossing_lines_have_a_square_zone() -> None:
    (zone,) = find_zones(EAST, NORTH, 2.0)
    corner = (street.CROSS + 1.75 + street.EXTENT, -1.75 + street.EXTENT)
    assert zone.begin_m == pytest.approx([at - 2.0 for at in corner], abs=1.1)
    assert zone.end_m == pytest.approx([at + 2.0 for at in corner], abs=1.1)
    assert not zone.along


def test_merging_lines_have_a_shared_zone() -> None:
    (zone,) = find_zones(EAST, LEFT, 2.0)
    assert zone.along
    assert zone.begin_m == (0.0, 0.0)
    # A follower stops at 98 m if the rear end of the car ahead is at 100 m.
    assert zone.limits[0][100] == pytest.approx(98.0, abs=1.1)
    assert zone.end_m[0] == pytest.approx(street.CROSS + street.EXTENT, abs=9.0)


def test_left_turns_yield_to_oncoming_lanes() -> None:
    (zone,) = find_zones(LEFT, WEST, 2.0)
    assert zone.first == 1
    assert find_zones(WEST, LEFT, 2.0)[0].first == 0


def test_distant_lines_have_no_zone() -> None:
    other = build_way([Piece(np.array([[0.0, 500.0], [300.0, 500.0]]), 10.0)])
    assert find_zones(EAST, other, 3.0) == []
    assert find_zones(EAST, WEST, 3.0) == []


def test_signal_states_follow_the_cycle() -> None:
    shown = signal_state(NETWORK, np.array([0.0, 21.9, 22.1, 25.1, 51.5, 52.0]))
    assert shown[:, 0].tolist() == [
        Signal.GREEN,
        Signal.GREEN,
        Signal.AMBER,
        Signal.RED,
        Signal.RED_AMBER,
        Signal.GREEN,
    ]
    assert signal_state(NETWORK, 30.0).tolist() == [Signal.RED, Signal.GREEN]
    assert signal_state(street.motorway(), np.zeros(3)).shape == (3, 0)


def test_cars_stop_at_red_and_continue_at_green() -> None:
    halt = EAST.halts[-1].at_m
    (schedule,) = run(car(EAST, enter_m=100.0), clock_s=20.0)
    standing = schedule.speed_mps < 0.01
    at = schedule.along_m[standing]
    assert len(at) > 100
    assert halt - 2.0 < at.min() <= at.max() <= halt + 0.1
    leaves = schedule.begin_s + 0.1 * np.flatnonzero(standing)[-1]
    assert 51.9 < 20.0 + leaves < 54.0
    assert np.diff(schedule.speed_mps).min() / 0.1 > -3.5


def test_a_follower_keeps_its_distance() -> None:
    slow = car(EAST, enter_m=140.0, end_m=380.0)
    slow = Participant("truck", 0, EAST, Chassis.of_box(8.0, 2.5), Manner(1.0, 5.0, 1.0, 2.0, 1.5), Aside(), 0.0, 140.0)
    first, second = run(slow, car(EAST, enter_m=60.0))
    times = np.arange(1.0, min(first.end_s, second.end_s), 0.1)
    gap = first.at(times)[0] - 8.0 - second.at(times)[0]
    assert gap.min() > 1.5
    assert second.at(times[-50:])[1].max() < 8.0


def test_left_turning_cars_avoid_oncoming_cars() -> None:
    oncoming = [car(WEST, enter_s=3.0 * number) for number in range(6)]
    turning, *_ = schedules = run(car(LEFT, enter_m=150.0), *oncoming)
    (zone,) = find_zones(LEFT, WEST, 2.4)
    inside = [turning.time_of(at) for at in (zone.begin_m[0], zone.end_m[0] + CAR.length_m)]
    for schedule in schedules[1:]:
        passes = [schedule.time_of(at) for at in (zone.begin_m[1], zone.end_m[1] + CAR.length_m)]
        assert passes[1] < inside[0] + 0.2 or passes[0] > inside[1] - 0.2


def test_turning_cars_wait_for_pedestrians() -> None:
    person = Participant(
        "pedestrian", 0, ZEBRA, Chassis(0.9, 0.5, 0.4, 0.25, 0.2), Manner(1.0, 1.4, 0.9, 1.2, 0.4), Aside(), 0.0,
        street.CROSS - 9.0 + street.EXTENT,
    )  # fmt: skip
    (zone,) = find_zones(LEFT, ZEBRA, 1.7)
    assert zone.first == 1
    turning, walking = run(car(LEFT, enter_m=200.0), person)
    inside = turning.time_of(zone.begin_m[0]), turning.time_of(zone.end_m[0] + CAR.length_m)
    crossing = walking.time_of(zone.begin_m[1]), walking.time_of(zone.end_m[1] + 0.9)
    assert inside[0] > crossing[1] - 0.3 or inside[1] < crossing[0] + 0.3


def test_a_pause_has_its_length() -> None:
    (schedule,) = run(car(EAST, enter_m=100.0, pause_m=150.0, pause_s=7.0))
    still = np.abs(schedule.along_m - 150.0) < 1.0
    assert 6.5 < 0.1 * (schedule.speed_mps[still] < 0.06).sum() < 9.0


def test_simulation_is_reproducible() -> None:
    road_users = [car(way, enter_s=2.0 * number) for number in range(5) for way in (EAST, NORTH, LEFT, WEST)]
    once, again = (simulate_participants(NETWORK, road_users, 5.0, 80.0) for _ in range(2))
    for a, b in zip(once, again):
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            assert np.array_equal(a.along_m, b.along_m) and np.array_equal(a.speed_mps, b.speed_mps)


@settings(deadline=None, max_examples=draws(60))
@given(
    st.lists(
        st.tuples(*[st.floats(-6, 6)] * 2, st.floats(-4, 4), st.floats(0.3, 4), st.floats(0.3, 4)),
        min_size=2,
        max_size=6,
    )
)
def test_overlaps_agree_with_shapely_polygons(rows) -> None:
    places = np.array([[row[:3]] for row in rows])
    halves = np.array([row[3:] for row in rows])
    kept = select_non_overlapping(places, halves, np.zeros(len(rows), np.bool_), 100.0)
    shapes = [
        affinity.translate(affinity.rotate(box(-h, -w, h, w), yaw, (0, 0), use_radians=True), x, y)
        for x, y, yaw, h, w in rows
    ]
    stays: list[int] = []
    for number, shape in enumerate(shapes):
        area = max((shape.intersection(shapes[other]).area for other in stays), default=0.0)
        if 0.0 < area < 1e-6:
            return
        if area == 0.0:
            stays.append(number)
    assert np.flatnonzero(kept).tolist() == stays


def test_fixed_users_stay_and_absent_users_exclude_nobody() -> None:
    places = np.array([[[0.0, 0.0, 0.0]], [[0.5, 0.0, 0.0]], [[math.nan] * 3]])
    halves = np.full((3, 2), 1.0)
    assert select_non_overlapping(places, halves, np.array([False, True, False]), 50.0).tolist() == [False, True, True]
    assert select_non_overlapping(places, halves, np.zeros(3, np.bool_), 50.0).tolist() == [True, False, True]
