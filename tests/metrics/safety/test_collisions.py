"""Collisions against shapely on finely resampled logs, and nuPlan's kinds on hand-made cases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.metrics.safety import Collision, CollisionKind, find_collisions
from tests.draws import draws
from tests.metrics.safety.logs import Actor, constant, moved, polygons, random_log, resample, state_log

TIMES = 0.1 * np.arange(21)


def kinds(*actors: Actor, **more) -> list[CollisionKind]:
    return [one.kind for one in find_collisions(state_log(TIMES, *actors), **more)]


@settings(max_examples=draws(60), deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_first_contact_is_where_polygons_first_meet(seed: int) -> None:
    log = random_log(np.random.default_rng(seed), agents=2, stamps=8)
    fine = resample(log, 100)
    found = {one.agent: one.stamp_ns for one in find_collisions(log)}
    for agent in (1, 2):
        ego, other = polygons(fine, 0), polygons(fine, agent)
        hits = np.flatnonzero(shapely.intersects(ego, other))
        name = log.ids[agent]
        if len(hits):
            # Polygons are tested every millisecond; the contact lies at most that much before.
            assert fine.stamps_ns[hits[0]] - 1_000_001 <= found[name] <= fine.stamps_ns[hits[0]] + 1_000
        elif name in found:
            # Shorter than the samples' distance.
            assert shapely.distance(ego, other).min() < 0.05


def test_contact_time_is_exact_for_a_known_closing_speed() -> None:
    ego, lead = constant(0, 0, 0, 20.0, TIMES), constant(30.0, 0, 0, 5.0, TIMES)
    (one,) = find_collisions(state_log(TIMES, ego, lead))
    assert one.stamp_ns - 1_700_000_000_000_000_000 == pytest.approx((30.0 - 4.5) / 15.0 * 1e9, abs=10)
    assert one.impact_speed_mps == pytest.approx(15.0)
    assert one == Collision("agent1", "car", one.stamp_ns, one.impact_speed_mps, CollisionKind.FRONT, True)


@pytest.mark.parametrize("speed", [10.0, 40.0, 80.0])
def test_nothing_is_jumped_over(speed: float) -> None:
    # Between two stamps a pole of 0.1 m crosses the whole of the ego.
    ego = constant(0, 0, 0, 0.0, TIMES, length_m=0.5, width_m=0.5)
    crossing = constant(-0.05 * speed - 10 * speed * 0.1, 0, 0, speed, TIMES, length_m=0.1, width_m=0.1)
    (one,) = find_collisions(state_log(TIMES, ego, crossing))
    expected = (0.05 * speed + speed - 0.3) / speed
    assert one.stamp_ns - 1_700_000_000_000_000_000 == pytest.approx(expected * 1e9, abs=10)


def test_turning_is_swept() -> None:
    # A long vehicle turns on the spot by 90 degrees within one step and sweeps over a pole that neither end covers.
    times = np.array([0.0, 0.5])
    turning = Actor(np.array([[0, 0, 0, 0, 0], [0, 0, np.pi / 2, 0, 0]], float), 12.0, 2.0)
    pole = Actor(np.tile([3.5, 3.5, 0, 0, 0], (2, 1)).astype(float), 0.2, 0.2)
    assert len(find_collisions(state_log(times, turning, pole))) == 1
    near_the_wrap = replace(
        state_log(times, turning, pole), yaw_rad=np.array([[-np.pi + 0.1, 0.0], [np.pi - 0.1, 0.0]])
    )
    assert find_collisions(near_the_wrap) == ()


def test_kinds_and_fault_as_nuplan_has_them() -> None:
    ego = constant(0, 0, 0, 10.0, TIMES)
    assert kinds(ego, constant(15, 0, 0, 2.0, TIMES)) == [CollisionKind.FRONT]
    assert kinds(ego, constant(15, 0, 0, 0.0, TIMES)) == [CollisionKind.STOPPED_AGENT]
    assert kinds(ego, constant(-15, 0, 0, 25.0, TIMES)) == [CollisionKind.REAR]
    assert kinds(constant(0, 0, 0, 0.0, TIMES), constant(-15, 0, 0, 25.0, TIMES)) == [CollisionKind.STOPPED_EGO]
    from_the_side = constant(10.0, -12.0, np.pi / 2, 10.0, TIMES)
    log = state_log(TIMES, ego, from_the_side)
    for between_lanes in (None, True, False):
        given_lanes = None if between_lanes is None else np.full(len(TIMES), between_lanes)
        (one,) = find_collisions(log, between_lanes=given_lanes)
        assert (one.kind, one.is_at_fault) == (CollisionKind.LATERAL, between_lanes)
    faults = [
        find_collisions(state_log(TIMES, ego, constant(15, 0, 0, speed, TIMES)))[0].is_at_fault for speed in (2, 0)
    ]
    assert faults == [True, True]
    assert find_collisions(state_log(TIMES, ego, constant(-15, 0, 0, 25.0, TIMES)))[0].is_at_fault is False


def test_an_ego_that_reverses_into_a_moving_agent_is_a_rear_collision() -> None:
    assert kinds(constant(0, 0, 0, -5.0, TIMES), constant(-12, 0, 0, 1.0, TIMES)) == [CollisionKind.REAR]


def test_each_agent_counts_once_and_in_order_of_time() -> None:
    ego = constant(0, 0, 0, 20.0, TIMES)
    log = state_log(TIMES, ego, constant(30, 0, 0, 0.0, TIMES), constant(15, 0, 0, 0.0, TIMES))
    assert [one.agent for one in find_collisions(log)] == ["agent2", "agent1"]


def test_absent_agents_do_not_collide() -> None:
    ego, lead = constant(0, 0, 0, 20.0, TIMES), constant(20, 0, 0, 0.0, TIMES)
    contact_row = 7
    for hidden, hit in ((slice(contact_row, None), False), (slice(0, contact_row), True)):
        present = np.ones((len(TIMES), 2), bool)
        present[hidden, 1] = False
        assert bool(find_collisions(state_log(TIMES, ego, lead, present=present))) is hit
    present = np.zeros((len(TIMES), 2), bool)
    present[:, 0] = True
    present[10, 1] = True
    (one,) = find_collisions(state_log(TIMES, ego, lead, present=present))
    assert one.stamp_ns == 1_700_000_001_000_000_000


@settings(max_examples=draws(40), deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-5e6, 5e6), st.floats(-5e6, 5e6), st.floats(-np.pi, np.pi))
def test_frame_and_order_do_not_matter(seed: int, x: float, y: float, turn: float) -> None:
    log = random_log(np.random.default_rng(seed), agents=4)
    found = find_collisions(log)
    for one, other in zip(found, find_collisions(moved(log, x, y, turn)), strict=True):
        assert one.agent == other.agent
        assert one.stamp_ns == pytest.approx(other.stamp_ns, abs=2_000)
    order = [0, 3, 1, 4, 2]
    columns = {name: getattr(log, name)[:, order] for name in ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps", "present")}
    sizes = {name: getattr(log, name)[order] for name in ("length_m", "width_m")}
    again = replace(log, **columns, **sizes, ids=tuple(log.ids[one] for one in order))
    assert sorted(find_collisions(again), key=lambda one: one.agent) == sorted(found, key=lambda one: one.agent)


def test_logs_of_one_stamp_and_one_actor() -> None:
    ego = constant(0, 0, 0, 5.0, [0.0])
    assert find_collisions(state_log([0.0], ego)) == ()
    (one,) = find_collisions(state_log([0.0], ego, constant(1.0, 0, 0, 5.0, [0.0])))
    assert one.stamp_ns == 1_700_000_000_000_000_000


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x_m": np.full((21, 2), np.nan)}, "x_m is nan"),
        ({"length_m": np.array([4.0, 0.0])}, "length_m is 0.0"),
        ({"stamps_ns": np.zeros(21, np.int64)}, "does not increase"),
        ({"ids": ("ego", "ego")}, "distinct ids"),
        ({"present": np.zeros((21, 2), bool)}, "the ego"),
        ({"yaw_rad": np.zeros((21, 3))}, "yaw_rad has shape"),
        ({"rear_axle_to_center_m": np.inf}, "rear_axle_to_center_m"),
    ],
)
def test_bad_logs_are_refused(change: dict[str, object], message: str) -> None:
    log = state_log(TIMES, constant(0, 0, 0, 1.0, TIMES), constant(9, 0, 0, 1.0, TIMES))
    with pytest.raises(UsageError, match=message):
        replace(log, **change)


def test_states_of_absent_actors_are_not_read() -> None:
    log = state_log(TIMES, constant(0, 0, 0, 20.0, TIMES), constant(20, 0, 0, 0.0, TIMES))
    present = log.present.copy()
    present[12:, 1] = False
    x = np.where(present, log.x_m, np.nan)
    assert find_collisions(replace(log, present=present, x_m=x)) == find_collisions(log)
    with pytest.raises(UsageError, match="between_lanes"):
        find_collisions(log, between_lanes=np.zeros(3, bool))
