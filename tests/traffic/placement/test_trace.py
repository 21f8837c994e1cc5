"""Tests of vehicle motion along a line against closed forms."""

import math
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.traffic.lanes.ways import STEP_M, Piece, build_way, change_lane_pieces, follow_lanes, lane_piece
from mirror.traffic.placement.trace import Aside, Chassis, Schedule, TraceMotion, build_trace
from tests.traffic import street

CAR = Chassis.of_box(4.5, 1.8)


def level(x, y):
    return np.zeros_like(x)


def circle(radius, share=1.0):
    angle = np.linspace(0.0, 2 * math.pi * share, 2000)
    return build_way([Piece(radius * np.column_stack([np.cos(angle), np.sin(angle)]), 30.0)])


@pytest.mark.parametrize("radius", [6.0, 12.0, 60.0])
def test_rear_axle_follows_the_circle_given_by_the_wheelbase(radius) -> None:
    ego = Chassis(4.6, 1.9, 2.8, 0.9, 0.0)
    trace = build_trace(circle(radius, 0.8), ego, level)
    along = np.linspace(0.5, 0.75, 50) * 2 * math.pi * radius
    placed, forward = trace.at(along)
    # Smoothing over 2 m, with a triangular kernel of variance 1 m2, reduces the radius by 1 / (2 radius).
    trail_rear_axle = math.sqrt((radius - 0.5 / radius) ** 2 - 2.8**2)
    assert np.hypot(*placed[:, :2].T) == pytest.approx(np.full(50, trail_rear_axle), abs=0.03)
    assert forward == pytest.approx(np.full(50, trail_rear_axle / (radius - 0.5 / radius)), rel=0.02)
    spoke = np.arctan2(placed[:, 1], placed[:, 0])
    turned = np.angle(np.exp(1j * (placed[:, 3] - spoke)))
    assert turned == pytest.approx(np.full(50, math.pi / 2), abs=0.006)


def test_pitch_and_roll_follow_the_slope() -> None:
    way = build_way([Piece(np.array([[0.0, 0.0], [100.0, 0.0]]), 10.0)])
    placed, _ = build_trace(way, CAR, lambda x, y: 0.05 * x + 0.03 * y).at(np.linspace(0.0, 100.0, 30))
    assert placed[:, 2] == pytest.approx(0.05 * placed[:, 0] + 0.03 * placed[:, 1], abs=1e-9)
    assert placed[:, 4] == pytest.approx(np.full(30, math.atan(0.05)))
    assert placed[:, 5] == pytest.approx(np.full(30, math.atan(0.03)))


def test_heading_and_curvature_are_continuous() -> None:
    network = street.network()
    turn = follow_lanes(network, ("main+0", "main+0>main+1", "main+1", "main+1>cross-1", "cross-1"))
    lanes = street.motorway().lanes
    change = build_way(change_lane_pieces(lanes["m0.0"], lanes["m0.1"], 40.0, 60.0))
    for way, most in ((turn, 0.40), (change, 0.02)):
        trace = build_trace(way, CAR, street.heights)
        along = np.arange(5.0, way.length_m - 5.0, 0.05)
        placed, _ = trace.at(along)
        bend = np.gradient(placed[:, 3], 0.05)
        assert np.abs(bend).max() < most
        assert np.abs(np.diff(bend)).max() < 0.05 * most
        step = np.gradient(placed[:, :2], 0.05, axis=0)
        assert np.abs(np.diff(np.hypot(*step.T))).max() < 2e-3
    assert build_trace(change, CAR, level).at(np.array([150.0]))[0][0, 1] == pytest.approx(3.6, abs=1e-6)


def test_trace_continues_straight_beyond_its_way() -> None:
    way = build_way([Piece(np.array([[0.0, 0.0], [30.0, 0.0]]), 10.0)])
    trace = build_trace(way, CAR, level)
    placed, forward = trace.at(np.array([-300.0, 500.0]))
    assert placed[:, :2] == pytest.approx(np.array([[-302.25, 0.0], [497.75, 0.0]]))
    assert forward == pytest.approx([1.0, 1.0])


def test_trace_keeps_the_given_offset_to_the_right() -> None:
    way = build_way([Piece(np.array([[0.0, 0.0], [0.0, 80.0]]), 10.0)])
    placed, _ = build_trace(way, CAR, level, Aside(0.4)).at(np.linspace(20.0, 70.0, 9))
    assert placed[:, 0] == pytest.approx(np.full(9, 0.4))


@given(
    st.lists(st.floats(0.0, 2.5), min_size=3, max_size=40),
    st.floats(-5.0, 5.0),
    st.floats(-20.0, 20.0),
)
def test_schedule_passes_its_knots_smoothly(accelerations, begin, start) -> None:
    speed = np.abs(np.cumsum(np.array(accelerations) - 1.2)) * 0.1
    along = start + np.concatenate([[0.0], np.cumsum(0.05 * (speed[1:] + speed[:-1]))])
    schedule = Schedule(begin, 0.1, along, speed)
    at, pace = schedule.at(begin + 0.1 * np.arange(len(speed)))
    assert at == pytest.approx(along, abs=1e-9)
    assert pace == pytest.approx(speed, abs=1e-7)
    near = begin + 0.1 * np.arange(len(speed))[:, None] + np.array([-1e-7, 1e-7])
    left, right = (schedule.at(near[:, side]) for side in (0, 1))
    assert left[0] == pytest.approx(right[0], abs=1e-5)
    assert left[1] == pytest.approx(right[1], abs=1e-4)
    shifted = schedule.since(2.0)
    assert shifted.at(np.array([0.5]))[0] == pytest.approx(schedule.at(np.array([2.5]))[0])


def test_time_of_inverts_the_schedule() -> None:
    schedule = Schedule(3.0, 0.1, np.linspace(0.0, 40.0, 81), np.full(81, 5.0))
    assert schedule.time_of(12.3) == pytest.approx(3.0 + 12.3 / 5.0, abs=1e-8)


def test_single_placement_agrees_with_the_batch_and_is_fast() -> None:
    way = circle(20.0)
    moving = TraceMotion(
        build_trace(way, CAR, street.heights), Schedule(0.0, 0.1, np.linspace(0, 90, 301), np.full(301, 3.0))
    )
    times = np.concatenate([np.linspace(-4.0, 40.0, 173), [0.0, 0.1, 30.0]])
    placed, forward = moving.trace.at(moving.schedule.at(times)[0])
    for row, slope, time_s in zip(placed, forward, times):
        at = moving.at(float(time_s))
        one = (at.x_m, at.y_m, at.z_m, at.yaw_rad, at.pitch_rad, at.roll_rad)
        assert one == pytest.approx(row, abs=1e-9)
        assert at.speed_mps == pytest.approx(slope * 3.0, rel=1e-6)
    best = math.inf
    for _ in range(5):
        start = time.perf_counter()
        for time_s in range(200):
            moving.at(0.1 * time_s)
        best = min(best, (time.perf_counter() - start) / 200)
    assert best < 100e-6


def test_allowed_speed_drops_before_bends() -> None:
    corner = np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 60.0]])
    way = build_way([Piece(corner, 14.0)])
    pace = way.pace_mps
    assert pace.min() < 4.0
    assert pace[0] == pytest.approx(14.0, abs=1.5)
    assert np.diff(pace**2).min() / (2 * STEP_M) > -1.4 - 1e-6


def test_ways_stop_at_the_stop_lines_of_lanes() -> None:
    way = follow_lanes(street.network(), ("main+1", "main+1>main+2", "main+2"))
    (halt,) = way.halts
    assert halt.group == 0
    assert halt.at_m == pytest.approx(street.network().lanes["main+1"].stop_m, abs=0.6)
    assert halt.clear_m == pytest.approx(halt.at_m + 20.5, abs=1.0)
    part = build_way([lane_piece(street.network().lanes["main+1"], 0.0, 60.0)])
    assert part.halts == ()


def test_ways_without_length_are_refused() -> None:
    with pytest.raises(UsageError, match="a way of"):
        build_way([Piece(np.array([[0.0, 0.0], [0.3, 0.0]]), 10.0)])


def test_trace_does_not_depend_on_the_distance_from_the_origin() -> None:
    line = circle(15.0, 0.6).points
    near, far = (
        build_trace(build_way([Piece(line + offset, 9.0)]), CAR, level).at(np.linspace(0.0, 50.0, 40))[0]
        for offset in (np.zeros(2), np.array([4e6, -3e6]))
    )
    assert far[:, :2] - [4e6, -3e6] == pytest.approx(near[:, :2], abs=1e-6)
    assert far[:, 3] == pytest.approx(near[:, 3], abs=1e-6)


def test_stationary_schedule_never_moves() -> None:
    schedule = Schedule(2.0, 0.1, np.full(2, 7.0), np.zeros(2))
    along, speed = schedule.at(np.array([-1e6, 0.0, 2.05, 1e6]))
    assert along == pytest.approx(np.full(4, 7.0))
    assert speed == pytest.approx(np.zeros(4))


def test_a_way_of_one_point_is_refused() -> None:
    with pytest.raises(UsageError, match=r"a way of 0\.00 m"):
        build_way([Piece(np.array([[3.0, 4.0]]), 10.0)])
    with pytest.raises(UsageError, match="a way of"):
        build_way([])
