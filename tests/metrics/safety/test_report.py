"""The figures of a whole rollout, and the driving scores."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.metrics.safety import FIGURES, SafetyReport, StateLog, score_rollout
from mirror.metrics.safety.driving_score import (
    collision_factor,
    combine_factors,
    direction_factor,
    progress_factor,
)
from tests.draws import draws
from tests.metrics.safety.logs import Actor, constant, moved, random_log, state_log
from tests.metrics.safety.streets import moved_map, two_way_street, with_signal

TIMES = 0.1 * np.arange(51)
ROUTE = np.stack([np.linspace(-40.0, 120.0, 161), np.zeros(161)], axis=1)
FACTORS = (
    "no_collision", "drivable_area", "driving_direction", "traffic_lights", "progress", "time_to_collision",
    "lane_keeping", "comfort",
)  # fmt: skip


def report_of(*actors: Actor, **more: object) -> SafetyReport:
    log = with_signal(state_log(TIMES, *actors), more.pop("signal", [0] * len(TIMES)))
    return score_rollout(log, two_way_street(), ROUTE, **more)


def test_a_clean_drive_has_the_full_score() -> None:
    report = report_of(constant(0, 0, 0, 10.0, TIMES), reference_m=50.0)
    assert list(report.figures) == list(FIGURES)
    assert all(figure.is_valid for figure in report.figures.values())
    assert report.figures["pdms"].value == report.figures["epdms"].value == 1.0
    assert math.isinf(report.figures["least_ttc"].value)
    assert report.figures["progress"].value == pytest.approx(50.0)
    assert report.figures["drivable_margin"].value == pytest.approx(5.25 - 0.9)
    assert {figure.cause for name, figure in report.figures.items() if name != "drivable_margin"} == {None}


def test_each_event_has_a_cause_and_an_instant() -> None:
    # The ego overtakes on the oncoming lane, hits the second standing car, and passes no red light.
    ego, lead, oncoming = (constant(0, y, 0, v, TIMES) for y, v in ((3.5, 10.0), (0.0, 0.0), (-3.5, 0.0)))
    lead = replace(lead, states=lead.states + np.array([30.0, 0, 0, 0, 0]))
    hit = replace(oncoming, states=oncoming.states + np.array([40.0, 7.0, 0, 0, 0]))
    figures = report_of(ego, lead, hit).figures
    assert figures["at_fault_collisions"].value == 1.0
    assert figures["at_fault_collisions"].cause == figures["least_ttc"].cause == "agent2"
    assert figures["impact_speed"].value == pytest.approx(10.0)
    assert (figures["collisions"].stamp_ns - 1_700_000_000_000_000_000) * 1e-9 == pytest.approx(3.55)
    assert figures["wrong_lane"].value == pytest.approx(50.0)
    assert figures["wrong_lane"].cause == "ego"
    assert figures["pdms"].value == figures["epdms"].value == 0.0


def test_the_impact_speed_is_that_of_the_hardest_collision() -> None:
    ego = constant(0, 0.0, 0, 10.0, TIMES)
    slow, standing = (constant(x, 0.0, 0, v, TIMES) for x, v in ((14.0, 7.0), (40.0, 0.0)))
    figures = score_rollout(state_log(TIMES, ego, slow, standing)).figures
    assert figures["collisions"].value == 2.0
    assert figures["impact_speed"].value == pytest.approx(10.0)
    assert figures["impact_speed"].cause == "agent2"


def test_without_a_map_or_a_route_figures_say_why_they_have_no_value() -> None:
    log = state_log(TIMES, constant(0, 0, 0, 10.0, TIMES), constant(-10, 3, 0, 30.0, TIMES))
    figures = score_rollout(log).figures
    needs_map = {"ttc_nuplan", "drivable_area", "drivable_margin", "off_road", "wrong_lane", "red_lights", "pdms"}
    for name in needs_map:
        assert "map" in figures[name].reason
        assert math.isnan(figures[name].value)
    assert "route" in figures["progress"].reason
    assert figures["comfort"].is_valid
    # A collision from the side: its fault depends on the lanes.
    side = constant(4.0, -12.0, np.pi / 2, 10.0, TIMES)
    figures = score_rollout(state_log(TIMES, constant(0, 0, 0, 3.0, TIMES), side)).figures
    assert figures["collisions"].value == 1
    assert "lanes" in figures["at_fault_collisions"].reason
    figures = score_rollout(with_signal(log, [0] * 51), two_way_street()).figures
    assert figures["pdms"].reason == "no route was given"


def test_a_log_of_one_stamp() -> None:
    log = with_signal(state_log([0.0], constant(0, 0, 0, 10.0, [0.0])), [0])
    figures = score_rollout(log, two_way_street(), ROUTE).figures
    assert figures["comfort"].reason == figures["pdms"].reason == "1 stamps; at least 4 are needed"
    assert figures["progress"].value == 0.0
    assert figures["drivable_area"].value == 1.0


def test_a_lateral_collision_is_at_fault_only_between_lanes() -> None:
    for y, fault in ((0.0, 0.0), (-1.75, 1.0)):
        ego = constant(0, y, 0, 3.0, TIMES)
        side = constant(2.0, 9.0, -np.pi / 2, 6.0, TIMES)
        figures = report_of(ego, side).figures
        assert figures["collisions"].value == 1.0
        assert figures["at_fault_collisions"].value == fault


def test_red_light_lane_keeping_and_direction_lower_the_scores() -> None:
    clean = report_of(constant(70, 0, 0, 10.0, TIMES), reference_m=50.0).score
    red = report_of(constant(70, 0, 0, 10.0, TIMES), reference_m=50.0, signal=[2] * 51).score
    assert (clean.traffic_lights, red.traffic_lights, red.epdms, red.pdms) == (1.0, 0.0, 0.0, 1.0)
    aside = report_of(constant(0, 0.6, 0, 10.0, TIMES), reference_m=50.0).score
    assert (aside.lane_keeping, aside.pdms) == (0.0, 1.0)
    assert aside.epdms == pytest.approx(12.0 / 14.0)
    assert report_of(constant(0, 0.4, 0, 10.0, TIMES), reference_m=50.0).score.lane_keeping == 1.0
    # The neighbouring lane of the same direction is not a lane of the route.
    beside = report_of(constant(0, -3.5, 0, 10.0, TIMES), reference_m=50.0).score
    assert (beside.driving_direction, beside.epdms) == (0.0, 0.0)


@pytest.mark.parametrize(("speed", "factor"), [(1.8, 1.0), (2.2, 0.5), (5.4, 0.5), (5.6, 0.0)])
def test_driving_direction_within_one_second(speed: float, factor: float) -> None:
    # Eleven steps are summed, as NAVSIM does.
    log = state_log(TIMES, constant(0, 0, 0, speed, TIMES))
    assert direction_factor(log, np.ones(51, bool)) == factor
    assert direction_factor(log, np.zeros(51, bool)) == 1.0
    half_a_second = np.zeros(51, bool)
    half_a_second[10:14] = True
    assert direction_factor(log, half_a_second) == (1.0 if 0.4 * speed < 2.0 else 0.5)


def test_progress_is_a_share_of_the_reference() -> None:
    assert [progress_factor(25.0, 50.0), progress_factor(70.0, 50.0), progress_factor(-3.0, 50.0)] == [0.5, 1.0, 0.0]
    assert progress_factor(0.0, 5.0) == 1.0


def test_objects_count_half() -> None:
    ego, cone = constant(0, 0, 0, 10.0, TIMES), constant(20, 0, 0, 0.0, TIMES, category="traffic_cone")
    assert report_of(ego, cone).score.no_collision == 0.5
    assert report_of(ego, cone, constant(40, 0, 0, 0.0, TIMES)).score.no_collision == 0.0
    assert collision_factor(()) == 1.0


@settings(max_examples=draws(100), deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=8, max_size=8))
def test_the_scores_are_their_formulas(values: list[float]) -> None:
    nc, dac, ddc, tlc, ep, ttc, lk, c = values
    score = combine_factors(**dict(zip(FACTORS, values)))
    assert score.pdms == pytest.approx(nc * dac * (5 * ep + 5 * ttc + 2 * c) / 12)
    assert score.epdms == pytest.approx(nc * dac * ddc * tlc * (5 * ep + 5 * ttc + 2 * lk + 2 * c) / 14)


@settings(max_examples=draws(20), deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-5e6, 5e6), st.floats(-5e6, 5e6), st.floats(-np.pi, np.pi))
def test_the_frame_and_the_order_of_agents_do_not_matter(seed: int, x: float, y: float, turn: float) -> None:
    log = with_signal(random_log(np.random.default_rng(seed), agents=4, stamps=20), [0] * 20)
    road_map, route = two_way_street(), ROUTE
    one = score_rollout(log, road_map, route)
    cos, sin = np.cos(turn), np.sin(turn)
    turned = route @ np.array([[cos, sin], [-sin, cos]]) + [x, y]
    two = score_rollout(moved(log, x, y, turn), moved_map(road_map, x, y, turn), turned)
    order = [0, 3, 1, 4, 2]
    columns = {name: getattr(log, name)[:, order] for name in ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps", "present")}
    sizes = {name: getattr(log, name)[order] for name in ("length_m", "width_m")}
    three = score_rollout(replace(log, **columns, **sizes, ids=tuple(log.ids[i] for i in order)), road_map, route)
    for name, figure in one.figures.items():
        assert three.figures[name].value == pytest.approx(figure.value, nan_ok=True)
        if name not in ("ttc_nuplan", "ttc_navsim_within_bound") and figure.value not in (0.0, math.inf):
            assert two.figures[name].value == pytest.approx(figure.value, abs=1e-3, nan_ok=True)


@pytest.mark.parametrize("bad", [{"horizon_s": 0.0}, {"route_m": [[0.0, 0.0]]}])
def test_bad_arguments_are_refused(bad: dict[str, object]) -> None:
    log: StateLog = state_log(TIMES, constant(0, 0, 0, 10.0, TIMES))
    with pytest.raises(UsageError):
        score_rollout(log, **bad)


def test_stability() -> None:
    """Huge offsets, tiny and large boxes, equal poses, standing actors and short steps give finite figures."""
    for offset, size, speed, step in itertools.product((0.0, 1e7), (1e-3, 30.0), (0.0, 60.0), (1e-3, 1.0)):
        times = step * np.arange(30)
        ego = constant(offset, 0, 0, speed, times)
        same = constant(offset, 0, 0, speed, times, length_m=size, width_m=size)
        far = constant(offset + 1e6, 5e5, 1.0, speed, times, length_m=size, width_m=size)
        report = score_rollout(state_log(times, ego, same, far))
        assert report.figures["least_ttc"].value == 0.0
        assert report.figures["collisions"].value == 1.0
        assert report.figures["impact_speed"].value == 0.0
        assert report.figures["comfort"].value in (0.0, 1.0)
        for figure in report.figures.values():
            assert figure.is_valid == (not math.isnan(figure.value))
