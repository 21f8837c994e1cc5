"""Defects of other simulators' safety metrics that ours do not have; each test is named after one.

They are listed, with their places in the source, in the study of other projects that this one was designed from.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mirror.metrics.safety import (
    drivable_area_compliance,
    find_collisions,
    least_time_to_collision,
    locate_on_lanes,
    measure_comfort,
    score_rollout,
    time_to_collision,
)
from tests.metrics.safety.logs import Actor, constant, resample, state_log
from tests.metrics.safety.streets import two_way_street, with_signal

TIMES = 0.1 * np.arange(21)


def test_nuplan_uses_the_magnitude_of_speed_so_that_a_reversing_ego_is_taken_to_drive_forwards() -> None:
    reversing = constant(0, 0, 0, -5.0, TIMES)
    behind, ahead = constant(-14.5, 0, 0, 0.0, TIMES), constant(14.5, 0, 0, 0.0, TIMES)
    assert time_to_collision(state_log(TIMES, reversing, behind))[0, 1] == pytest.approx(2.0)
    assert math.isinf(least_time_to_collision(state_log(TIMES, reversing, ahead)).value_s)


def test_nuplan_leaves_out_the_end_of_its_horizon() -> None:
    log = state_log([0.0], constant(0, 0, 0, 10.0, [0.0]), constant(34.5, 0, 0, 0.0, [0.0]))
    assert least_time_to_collision(log, horizon_s=3.0).value_s == 3.0


def test_nuplan_rounds_time_to_collision_up_to_its_step() -> None:
    log = state_log([0.0], constant(0, 0, 0, 10.0, [0.0]), constant(4.5 + 9.5, 0, 0, 0.0, [0.0]))
    assert least_time_to_collision(log).value_s == pytest.approx(0.95, abs=1e-12)


def test_nuplan_sees_no_collision_between_stamps() -> None:
    ego = constant(0, 0, 0, 0.0, TIMES)
    crossing = constant(0.0, -22.0, np.pi / 2, 40.0, TIMES, length_m=0.5, width_m=0.5)
    (one,) = find_collisions(state_log(TIMES, ego, crossing))
    assert (one.stamp_ns - 1_700_000_000_000_000_000) * 1e-9 == pytest.approx((22.0 - 0.9 - 0.25) / 40.0, abs=1e-6)


def test_navsim_treats_a_bound_of_zero_as_none() -> None:
    log = state_log(TIMES, constant(0, 0, 0, 10.0, TIMES))
    speeding = replace(log, vx_mps=log.vx_mps + 0.5 * TIMES[:, None])
    bounds = {"longitudinal_acceleration_mps2": (-4.05, 0.0)}
    assert measure_comfort(log, bounds).is_comfortable
    assert not measure_comfort(speeding, bounds).is_comfortable


def test_navsim_compares_only_at_four_instants() -> None:
    # The agent crosses the ego's path between 0.3 and 0.6 s.
    ego = constant(0, 0, 0, 10.0, TIMES)
    crossing = constant(7.0, -12.0, np.pi / 2, 26.0, TIMES, length_m=1.0, width_m=0.5)
    least = least_time_to_collision(state_log(TIMES, ego, crossing))
    assert 0.0 <= least.value_s < 0.6
    assert least.agent == "agent1"


def test_hugsim_computes_lateral_accelerations_of_zero() -> None:
    yaw = 0.4 * TIMES
    columns = [25 * np.sin(yaw), 25 * (1 - np.cos(yaw)), yaw, 10 * np.cos(yaw), 10 * np.sin(yaw)]
    found = measure_comfort(state_log(TIMES, Actor(np.stack(columns, axis=1))))
    np.testing.assert_allclose(found.quantities["lateral_acceleration_mps2"], 4.0, rtol=0.02)


def test_hugsim_swaps_the_axes_so_that_a_straight_drive_turns_by_ninety_degrees() -> None:
    for yaw in (0.0, 1.0, -2.5):
        found = measure_comfort(state_log(TIMES, constant(0, 0, yaw, 10.0, TIMES)))
        for values in found.quantities.values():
            np.testing.assert_allclose(values, 0.0, atol=1e-9)
        positions = locate_on_lanes(state_log(TIMES, constant(0, 0, 0.0, 10.0, TIMES)), two_way_street())
        np.testing.assert_allclose(positions.turned_rad[:, 0], 0.0, atol=1e-12)


@pytest.mark.parametrize("outside_m", [0.01, 0.29, 0.31, 1.2])
def test_hugsim_and_drivearena_judge_the_drivable_area_by_shares_of_cells(outside_m: float) -> None:
    ring = [[-10.0, -3.0], [100.0, -3.0], [100.0, 3.0], [-10.0, 3.0]]
    log = state_log(TIMES, constant(0.0, 3.0 - 0.9 + outside_m, 0.0, 10.0, TIMES))
    found = drivable_area_compliance(log, [ring])
    assert found.least_margin_m == pytest.approx(-outside_m)
    assert found.is_compliant is (outside_m < 0.3)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_alpasim_lets_the_last_intersecting_actor_decide(order: tuple[int, ...]) -> None:
    ego = constant(0, 0, 0, 10.0, TIMES)
    # One collision at fault, one from behind, and one agent that is not touched.
    others = (constant(9, 0, 0, 0.0, TIMES), constant(-12, 0, 0, 25.0, TIMES), constant(0, 30, 0, 0.0, TIMES))
    log = with_signal(state_log(TIMES, ego, *(others[index] for index in order)), [0] * len(TIMES))
    report = score_rollout(log, two_way_street())
    assert report.figures["collisions"].value == 2
    assert report.figures["at_fault_collisions"].value == 1
    assert report.figures["at_fault_collisions"].cause == f"agent{1 + order.index(0)}"
    least = least_time_to_collision(log)
    assert np.isfinite(least.by_agent_s).sum() == 2


def test_metrics_at_stamps_depend_on_the_rate_of_the_log() -> None:
    ego, oncoming = constant(0, 0, 0, 20.0, TIMES), constant(75, 1.0, np.pi, 17.0, TIMES)
    log = state_log(TIMES, ego, oncoming)
    fine = resample(log, 10)
    (one,), (other,) = find_collisions(log), find_collisions(fine)
    assert one.stamp_ns == pytest.approx(other.stamp_ns, abs=1_000)
    assert least_time_to_collision(log).value_s == least_time_to_collision(fine).value_s == 0.0
