"""The presets against their published definitions, written down a second time with shapely, and on hand-made cases."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.metrics.safety import (
    CollisionKind,
    StateLog,
    collisions_at_stamps,
    navsim_time_to_collision,
    nuplan_time_to_collision,
)
from tests.metrics.safety.logs import Actor, constant, polygon, random_log, rectangle, state_log

TIMES = 0.1 * np.arange(41)
NOWHERE = np.zeros(len(TIMES), bool)
ANYWHERE = ~NOWHERE
START = 1_700_000_000_000_000_000


def nuplan(*actors: Actor, between: np.ndarray = NOWHERE, junction: np.ndarray = NOWHERE):
    return nuplan_time_to_collision(state_log(TIMES, *actors), between_lanes=between, in_junction=junction)


def navsim(*actors: Actor, between: np.ndarray = NOWHERE, junction: np.ndarray = NOWHERE):
    return navsim_time_to_collision(state_log(TIMES, *actors), between_lanes=between, in_junction=junction)


def bearing(log: StateLog, row: int, x: float, y: float) -> float:
    """Angle in degrees between the ego's heading and the direction from its rear axle to a point."""
    yaw = log.yaw_rad[row, 0]
    forward = np.array([np.cos(yaw), np.sin(yaw)])
    ahead = np.array([x - log.x_m[row, 0], y - log.y_m[row, 0]]) + log.rear_axle_to_center_m * forward
    return math.degrees(math.acos(np.clip(ahead @ forward / np.linalg.norm(ahead), -1.0, 1.0)))


def moved_box(log: StateLog, actor: int, row: int, ahead_s: float):
    """The box some time later, along its heading at the magnitude of its speed."""
    speed = np.hypot(log.vx_mps[row, actor], log.vy_mps[row, actor])
    yaw = log.yaw_rad[row, actor]
    return rectangle(
        log.x_m[row, actor] + ahead_s * speed * np.cos(yaw), log.y_m[row, actor] + ahead_s * speed * np.sin(yaw),
        yaw, log.length_m[actor], log.width_m[actor],
    )  # fmt: skip


def nuplan_by_shapely(log: StateLog, between: np.ndarray, junction: np.ndarray, at_fault: set[int]) -> np.ndarray:
    values, collided = np.full(len(log.stamps_ns), np.inf), set()
    for row in range(len(log.stamps_ns)):
        agents = range(1, len(log.ids))
        collided |= {agent for agent in agents if polygon(log, 0, row).intersects(polygon(log, agent, row))}
        if row in at_fault:
            values[row] = 0.0
            continue
        counted = []
        for agent in agents:
            angle = bearing(log, row, log.x_m[row, agent], log.y_m[row, agent])
            if agent not in collided and (angle < 30.0 or ((between[row] or junction[row]) and angle <= 150.0)):
                counted.append(agent)
        if np.hypot(log.vx_mps[row, 0], log.vy_mps[row, 0]) <= 5e-3:
            continue
        for ahead_s in np.arange(0.1, 3.0, 0.1):
            ego = moved_box(log, 0, row, ahead_s)
            if any(ego.intersects(moved_box(log, agent, row, ahead_s)) for agent in counted):
                values[row] = ahead_s
                break
    return values


def navsim_by_shapely(log: StateLog, between: np.ndarray, junction: np.ndarray) -> tuple[int, int]:
    agents = range(1, len(log.ids))
    left_out = {agent for agent in agents if polygon(log, 0, 0).intersects(polygon(log, agent, 0))}
    for row in range(len(log.stamps_ns) - 9):
        for steps in (0, 3, 6, 9):
            ego = moved_box(log, 0, row, 0.1 * steps)
            for agent in agents:
                there = polygon(log, agent, row + steps)
                slow = np.hypot(log.vx_mps[row, 0], log.vy_mps[row, 0]) < 5e-3
                if agent in left_out or slow or not ego.intersects(there):
                    continue
                angle = bearing(log, row, there.centroid.x, there.centroid.y)
                if angle < 30.0 or ((between[row] or junction[row]) and angle <= 150.0):
                    return row, agent
                left_out.add(agent)
    return -1, -1


@pytest.mark.parametrize("seed", range(24))
def test_nuplan_agrees_with_its_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    log = random_log(rng, agents=3, stamps=12)
    between, junction = rng.random((2, 12)) < 0.3
    found = nuplan_time_to_collision(log, between_lanes=between, in_junction=junction)
    rows = {int(stamp): row for row, stamp in enumerate(log.stamps_ns)}
    at_fault = {rows[one.stamp_ns] for one in collisions_at_stamps(log, between) if one.is_at_fault}
    expected = nuplan_by_shapely(log, between, junction, at_fault)
    np.testing.assert_allclose(found.value_s, expected, atol=1e-9)
    assert found.least_s == pytest.approx(expected.min(), abs=1e-9)
    assert (found.agent is None) == math.isinf(found.least_s)


@pytest.mark.parametrize("seed", range(24))
def test_navsim_agrees_with_its_definition(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    log = random_log(rng, agents=4, stamps=25)
    between, junction = rng.random((2, 25)) < 0.2
    found = navsim_time_to_collision(log, between_lanes=between, in_junction=junction)
    row, agent = navsim_by_shapely(log, between, junction)
    assert found.is_within_bound is (row < 0)
    assert found.agent == (None if row < 0 else log.ids[agent])
    assert found.stamp_ns == (None if row < 0 else log.stamps_ns[row])


@pytest.mark.parametrize("seed", range(24))
def test_collisions_at_stamps_are_overlaps_at_stamps(seed: int) -> None:
    log = random_log(np.random.default_rng(seed), agents=4, stamps=12)
    found = {one.agent: one for one in collisions_at_stamps(log, np.zeros(12, bool))}
    for agent in range(1, 5):
        hits = [row for row in range(12) if polygon(log, 0, row).intersects(polygon(log, agent, row))]
        assert bool(hits) == (log.ids[agent] in found)
        if hits:
            one = found[log.ids[agent]]
            assert one.stamp_ns == log.stamps_ns[hits[0]]
            assert one.is_at_fault is (one.kind in (CollisionKind.FRONT, CollisionKind.STOPPED_AGENT))


def test_nuplan_by_hand() -> None:
    ego = constant(0, 0, 0, 10.0, TIMES)
    # Bumper to bumper 25.5 m at 10 m/s relative: contact after 2.55 s, so the step of 2.6 s is the first to overlap.
    lead = constant(30.0, 0, 0, 0.0, TIMES)
    found = nuplan(ego, lead)
    assert found.value_s[0] == pytest.approx(2.6)
    # Contact after 0.95 s falls on the step of 1.0 s, and one stamp later of 0.85 s on 0.9 s: out of bound.
    assert found.value_s[16] == pytest.approx(1.0)
    assert found.value_s[17] == pytest.approx(0.9)
    assert not found.is_within_bound
    assert found.agent == "agent1"
    # The collision with a standing agent is at fault: 0 at that stamp, nothing after it.
    assert found.value_s[26] == 0.0
    assert np.isinf(found.value_s[27:]).all()
    assert found.stamp_ns == START + 2_600_000_000


def test_nuplan_counts_agents_beside_only_between_lanes_or_in_a_junction() -> None:
    ego = constant(0, 0, 0, 5.0, TIMES)
    # An agent beside the ego drives into its side, which it sees at about 60 degrees.
    beside = constant(2.0, 6.0, -np.pi / 2, 3.0, TIMES)
    assert math.isinf(nuplan(ego, beside).value_s[0])
    for where in ({"between": ANYWHERE}, {"junction": ANYWHERE}):
        assert nuplan(ego, beside, **where).value_s[0] < 3.0
    behind = constant(-15.0, 0, 0, 15.0, TIMES)
    assert math.isinf(nuplan(ego, behind, between=ANYWHERE).value_s[0])


def test_nuplan_has_no_value_for_a_standing_ego() -> None:
    oncoming = constant(20.0, 0, np.pi, 5.0, TIMES)
    assert math.isinf(nuplan(constant(0, 0, 0, 5e-3, TIMES), oncoming).value_s[0])
    assert nuplan(constant(0, 0, 0, 2.0, TIMES), oncoming).value_s[0] == pytest.approx(2.3)


def test_navsim_by_hand() -> None:
    ego = constant(0, 0, 0, 10.0, TIMES)
    # A lead that brakes: its logged future counts, not its velocity.
    gap = 4.5 + 8.9
    assert navsim(ego, constant(gap, 0, 0, 0.0, TIMES)).stamp_ns == START
    standing = constant(4.5 + 9.1, 0, 0, 0.0, TIMES)
    assert navsim(ego, standing).stamp_ns == START + 100_000_000
    x = 13.6 + np.where(TIMES < 0.05, 0.0, 100.0)
    gone = Actor(np.stack([x, 0 * TIMES, 0 * TIMES, 0 * TIMES, 0 * TIMES], axis=1))
    assert navsim(ego, gone).is_within_bound
    # An agent that rams the ego from behind does not count, even between lanes, and is left out from then on.
    creeping, behind = constant(0, 0, 0, 1.0, TIMES), constant(-15.0, 0, 0, 8.0, TIMES)
    assert navsim(creeping, behind, between=ANYWHERE).is_within_bound
    # The place of a faster ego's contact lies ahead of where the ego is now, so the same agent counts.
    assert not navsim(ego, constant(-15.0, 0, 0, 30.0, TIMES)).is_within_bound
    slow = constant(0, 0, 0, 4e-3, TIMES)
    assert navsim(slow, constant(6.0, 0, np.pi, 5.0, TIMES)).is_within_bound


def test_navsim_does_not_test_the_last_stamps() -> None:
    # The ego meets the standing agent only from 3.2 s on, with 0.8 s left.
    ego, standing = constant(0, 0, 0, 10.0, TIMES), constant(4.5 + 9.0 + 31.5, 0, 0, 0.0, TIMES)
    assert navsim(ego, standing).is_within_bound


def test_navsim_interpolates_logs_of_another_rate() -> None:
    times = 0.25 * np.arange(17)
    actors = constant(0, 0, 0, 10.0, times), constant(4.5 + 14.0, 0, 0, 5.0, times)
    none = np.zeros(17, bool)
    # Closing at 5 m/s from 14 m: a gap of at most 4.5 m, so contact within 0.9 s, from 1.9 s on.
    found = navsim_time_to_collision(state_log(times, *actors), between_lanes=none, in_junction=none)
    assert found.stamp_ns == START + 2_000_000_000


def test_agents_appear_and_disappear() -> None:
    log = state_log(TIMES, constant(0, 0, 0, 10.0, TIMES), constant(30.0, 0, 0, 0.0, TIMES))
    present = log.present.copy()
    present[:20, 1] = False
    from dataclasses import replace

    late = replace(log, present=present)
    found = nuplan_time_to_collision(late, between_lanes=NOWHERE, in_junction=NOWHERE)
    assert np.isinf(found.value_s[:20]).all()
    assert found.value_s[20] == pytest.approx(0.6)
    # At 1.4 s the future at 0.6 s exists.
    assert navsim_time_to_collision(late, between_lanes=NOWHERE, in_junction=NOWHERE).stamp_ns == START + 1_700_000_000


def test_arrays_of_another_length_are_refused() -> None:
    log = state_log(TIMES, constant(0, 0, 0, 10.0, TIMES))
    for between, junction, name in ((NOWHERE[1:], NOWHERE, "between_lanes"), (NOWHERE, 0.0 * TIMES, "in_junction")):
        for preset in (nuplan_time_to_collision, navsim_time_to_collision):
            with pytest.raises(UsageError, match=name):
                preset(log, between_lanes=between, in_junction=junction)


def test_one_stamp_and_no_agent() -> None:
    log = state_log([0.0], constant(0, 0, 0, 10.0, [0.0]))
    none = np.zeros(1, bool)
    found = nuplan_time_to_collision(log, between_lanes=none, in_junction=none)
    assert (found.least_s, found.agent, found.stamp_ns, found.is_within_bound) == (math.inf, None, None, True)
    assert navsim_time_to_collision(log, between_lanes=none, in_junction=none).is_within_bound
    assert collisions_at_stamps(log, none) == ()
