"""Agents: reactions, scripts and their triggers, attacks, replay, and independence of their order."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hybridworldsim.simulator.agents.attack import Attacker, AttackPlan, search_attack
from hybridworldsim.simulator.agents.replay import RecordedTrack
from hybridworldsim.simulator.agents.states import Agent
from hybridworldsim.simulator.ego.vehicle import Controls
from hybridworldsim.simulator.policies.references import LaneKeeping
from hybridworldsim.simulator.simulation import Simulation, start_simulation
from mirror.errors import UsageError
from mirror.metrics.safety import find_collisions, least_time_to_collision
from mirror.traffic.lanes.ways import Piece, build_way
from tests.simulator.streets import LANE_M, scenario, straight_street

STREET = straight_street()
COAST = Controls(0.0, 0.0)


def run(simulation: Simulation, action: Controls | None = COAST) -> str:
    policy = LaneKeeping()
    policy.reset(simulation.observation_spec({}))
    ending = None
    while ending is None:
        ending = simulation.advance(action or policy.act(simulation.observe({}, privileged=True)))
    return ending


def column(simulation: Simulation, agent: str, name: str) -> np.ndarray:
    log = simulation.recorder.log()
    return getattr(log, name)[:, log.ids.index(agent)]


def test_vehicles_react_to_an_ego_that_stands() -> None:
    traffic = {"id": "traffic", "count": 25, "behaviour": {"kind": "idm", "radius_m": 200.0}}
    simulation = start_simulation(STREET, scenario(traffic, along_m=200.0, duration_s=25.0), stops_at_collision=False)
    assert len(simulation.now.agents) > 10
    assert run(simulation, Controls(-4.0, 0.0)) == "duration"
    assert not find_collisions(simulation.recorder.log())
    behind = [
        agent
        for agent in simulation.recorder.log().ids[1:]
        if column(simulation, agent, "x_m")[0] < 200.0 and abs(column(simulation, agent, "y_m")[0] + 1.75) < 1.0
    ]
    assert behind
    for agent in behind:
        assert math.hypot(column(simulation, agent, "vx_mps")[-1], column(simulation, agent, "vy_mps")[-1]) < 0.5


def test_vehicles_do_not_touch_each_other() -> None:
    traffic = {"id": "traffic", "count": 25, "behaviour": {"kind": "idm", "radius_m": 200.0}}
    simulation = start_simulation(STREET, scenario(traffic, along_m=200.0, duration_s=10.0), stops_at_collision=False)
    run(simulation, None)
    log = simulation.recorder.log()
    for actor in range(len(log.ids)):
        order = [actor, *(other for other in range(len(log.ids)) if other != actor)]
        columns = {name: getattr(log, name)[:, order] for name in ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps")}
        present = log.present[:, order]
        if not present[:, 0].all():
            continue
        turned = replace(
            log, **columns, present=present, length_m=log.length_m[order], width_m=log.width_m[order],
            ids=tuple(log.ids[k] for k in order), categories=tuple(log.categories[k] for k in order),
        )  # fmt: skip
        assert not find_collisions(turned), log.ids[actor]


def test_the_order_of_agents_does_not_matter() -> None:
    members = [
        {"id": "lead", "behaviour": {"kind": "idm", "ahead_m": 15.0, "speed_mps": 9.0}},
        {
            "id": "brake",
            "behaviour": {"kind": "hard-brake", "ahead_m": 60.0, "speed_mps": 9.0, "trigger": {"ttc_s": 5}},
        },
        {"id": "far", "behaviour": {"kind": "idm", "ahead_m": 40.0, "speed_mps": 9.0}},
        {"id": "across", "behaviour": {"kind": "cut-in", "side": "right", "ahead_m": 90.0, "trigger": {"ttc_s": 9}}},
    ]
    logs = []
    for order in ((0, 1, 2, 3), (3, 1, 0, 2)):
        simulation = start_simulation(STREET, scenario(*(members[k] for k in order)))
        run(simulation, None)
        logs.append(simulation.recorder.log())
    assert logs[0].ids == logs[1].ids
    for name in ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps"):
        assert np.array_equal(getattr(logs[0], name), getattr(logs[1], name))


def test_a_seed_gives_the_same_rollout_and_another_seed_another() -> None:
    traffic = {"id": "traffic", "count": 8, "behaviour": {"kind": "idm"}}
    logs = []
    for seed in (3, 3, 4):
        simulation = start_simulation(STREET, scenario(traffic), seed)
        run(simulation, None)
        logs.append(simulation.recorder.log())
    assert np.array_equal(logs[0].x_m, logs[1].x_m)
    assert logs[0].x_m.shape != logs[2].x_m.shape or not np.array_equal(logs[0].x_m, logs[2].x_m)


def test_hard_brake_begins_at_its_time_to_collision() -> None:
    member = {
        "id": "lead",
        "behaviour": {
            "kind": "hard-brake", "ahead_m": 30.0, "speed_mps": 8.0, "deceleration_mps2": 6.0,
            "trigger": {"ttc_s": 2.5},
        },
    }  # fmt: skip
    simulation = start_simulation(STREET, scenario(member, duration_s=12.0))
    assert run(simulation) == "collision"
    log = simulation.recorder.log()
    gap = log.x_m[:, 1] - log.x_m[:, 0] - 0.5 * (log.length_m[0] + log.length_m[1])
    speed = log.vx_mps[:, 1]
    braking = int(np.argmax(speed < 7.99)) - 1
    # It decides on the state of a stamp, so the time to collision is at most one step below its threshold.
    assert 2.5 - 0.1 <= gap[braking] / 10.0 <= 2.5
    assert speed[-1] == 0.0
    assert np.diff(speed).min() >= -0.6 - 1e-9


def test_cut_in_changes_to_the_lane_of_the_ego() -> None:
    member = {
        "id": "cutter",
        "behaviour": {"kind": "cut-in", "side": "right", "ahead_m": 30.0, "speed_mps": 6.0, "trigger": {"ttc_s": 4.0}},
    }
    simulation = start_simulation(STREET, scenario(member), stops_at_collision=False)
    run(simulation)
    aside = column(simulation, "cutter", "y_m")
    assert aside[0] == pytest.approx(-1.5 * LANE_M, abs=1e-6)
    assert aside[-1] == pytest.approx(-0.5 * LANE_M, abs=1e-6)
    assert np.abs(np.diff(aside, 2)).max() / 0.01 < 4.0


def test_an_oncoming_vehicle_returns_to_its_lane() -> None:
    member = {"id": "oncoming", "behaviour": {"kind": "oncoming-overtake", "ahead_m": 110.0, "trigger": {"ttc_s": 4.5}}}
    simulation = start_simulation(STREET, scenario(member), stops_at_collision=False)
    run(simulation)
    aside = column(simulation, "oncoming", "y_m")
    assert aside[0] == pytest.approx(0.5 * LANE_M, abs=1e-6)
    assert aside.min() == pytest.approx(-0.5 * LANE_M, abs=1e-6)
    assert aside[-1] == pytest.approx(0.5 * LANE_M, abs=1e-6)
    assert (column(simulation, "oncoming", "vx_mps") < 0.0).all()


def test_a_pedestrian_stands_until_the_ego_comes_and_then_crosses() -> None:
    member = {
        "id": "walker",
        "category": "pedestrian",
        "behaviour": {"kind": "crossing-pedestrian", "ahead_m": 45.0, "trigger": {"ttc_s": 3.0}},
    }
    simulation = start_simulation(STREET, scenario(member), stops_at_collision=False)
    run(simulation)
    log = simulation.recorder.log()
    moving = int(np.argmax(np.abs(log.vy_mps[:, 1]) > 0.0))
    front = log.x_m[moving - 1, 0] + 0.5 * log.length_m[0]
    assert 3.0 - 0.1 <= (log.x_m[0, 1] - front) / 10.0 <= 3.0
    assert log.y_m[-1, 1] > log.y_m[0, 1] + 4.0


def test_a_queue_stands_and_a_reacting_ego_stops_behind_it() -> None:
    queue = {"id": "queue", "count": 3, "behaviour": {"kind": "stopped-queue", "ttc_s": 6.0}}
    simulation = start_simulation(STREET, scenario(queue, duration_s=15.0))
    assert run(simulation, None) == "duration"
    assert simulation.now.ego.speed_mps < 0.1
    for name in simulation.recorder.log().ids[1:]:
        assert np.ptp(column(simulation, name, "x_m")) == 0.0


def test_an_attack_is_found_in_fifty_evaluations() -> None:
    way = build_way([Piece(np.array([(0.0, 0.0), (400.0, 0.0)]), 13.9)])
    attacker = Attacker(way, 60.0, 8.0, 3.5, 4.5, 1.8)
    boxes = np.array([[40.0, 0.0, 0.0, 10.0, 2.35, 0.92, 1.0], [57.75, 3.5, 0.0, 8.0, 2.25, 0.9, 1.0]])

    def ego_line(times: np.ndarray) -> np.ndarray:
        return np.column_stack([40.0 + 10.0 * times, 0.0 * times, 0.0 * times])

    found = search_attack(attacker, AttackPlan(1.0), boxes, 1, ego_line=ego_line)
    assert found.evaluations == 50
    assert found.least_ttc_s < 0.5
    few = search_attack(attacker, AttackPlan(1.0, evaluations=1), boxes, 1, ego_line=ego_line)
    assert math.isinf(few.least_ttc_s)
    again = search_attack(attacker, AttackPlan(1.0), boxes, 1, ego_line=ego_line)
    assert again == found
    blocked = search_attack(
        attacker, AttackPlan(1.0), boxes, 1, ego_line=ego_line, is_drivable=lambda points: points[:, 1].min() > 3.49
    )
    assert math.isinf(blocked.least_ttc_s)


def test_an_attack_endangers_an_ego_that_does_not_react() -> None:
    member = {
        "id": "attacker",
        "behaviour": {"kind": "attack", "ahead_m": 15.0, "trigger": {"ttc_s": 5, "latest_s": 1}},
    }
    simulation = start_simulation(STREET, scenario(member), stops_at_collision=False)
    run(simulation)
    assert least_time_to_collision(simulation.recorder.log()).value_s < 0.5


def test_replayed_agents_repeat_the_recording_whatever_the_ego_does() -> None:
    times = np.arange(0.0, 5.01, 0.5)
    poses = np.column_stack([120.0 + 3.0 * times, 0.1 * times**2, 0.05 * times])
    track = RecordedTrack(Agent("car-7", "car", (4.5, 1.8, 1.5)), times, poses)
    recording = replace(STREET.recordings["drive-1"], tracks=(track,))
    street = replace(STREET, recordings={"drive-1": recording})
    recorded = {"start": {"kind": "recorded", "after_s": 1.0}}
    replayed = {"id": "log", "behaviour": {"kind": "replay"}}
    simulation = start_simulation(street, scenario(replayed, ego=recorded, duration_s=6.0))
    assert simulation.now.ego.speed_mps == pytest.approx(8.0)
    run(simulation, Controls(3.0, 0.01))
    log = simulation.recorder.log()
    present = log.present[:, 1]
    assert present.sum() == 41
    expected = np.interp(1.0 + log.times_s[present], times, poses[:, 0])
    assert np.allclose(log.x_m[present, 1], expected, atol=1e-9)
    with pytest.raises(UsageError, match="no road user 'van-1'"):
        wanted = {"id": "log", "behaviour": {"kind": "replay", "tracks": ["van-1"]}}
        start_simulation(street, scenario(wanted, ego=recorded))


@pytest.mark.parametrize(
    ("behaviour", "message"),
    [
        ({"kind": "idm", "ahead_m": 900.0}, "off its route"),
        ({"kind": "pull-out", "ahead_m": 40.0, "offset_m": 9.9, "trigger": {"ttc_s": 1}}, "off the drivable area"),
    ],
)
def test_agents_that_do_not_fit_are_refused(behaviour: dict, message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        start_simulation(STREET, scenario({"id": "misfit", "behaviour": behaviour}))
    assert "misfit" in str(caught.value)


def test_starts_and_routes_off_the_map_are_refused() -> None:
    with pytest.raises(UsageError, match="not on a driving lane"):
        pose = {"start": {"kind": "pose", "x_m": 10.0, "y_m": 60.0, "yaw_deg": 0.0}}
        start_simulation(STREET, scenario(ego=pose))
    with pytest.raises(UsageError, match="lane 'missing'"):
        start_simulation(STREET, scenario(lane="missing"))
    with pytest.raises(UsageError, match="does not follow"):
        start_simulation(STREET, scenario(ego={"route": {"lanes": ["slow", "oncoming"]}}))
    with pytest.raises(UsageError, match="'missing'"):
        start_simulation(STREET, scenario(ego={"start": {"kind": "recorded", "traversal": "missing"}}))
