"""Agents at drawn places: the first free place of each agent, as one that tries them one by one finds it."""

from __future__ import annotations

import hashlib
import math

import numpy as np
import pytest

from hybridworldsim.simulator.agents.bodies import draw_body
from hybridworldsim.simulator.ego.vehicle import EgoState
from hybridworldsim.simulator.simulation import start_simulation
from hybridworldsim.simulator.street.obstacles import Walls
from hybridworldsim.simulator.street.opening import open_street
from hybridworldsim.simulator.street.route import onward_lanes, way_along
from hybridworldsim.simulator.street.street import Street
from mirror.schema.behaviours import Idm
from mirror.schema.scenario import Scenario
from mirror.synth import Label, cast_rays
from mirror.traffic.lanes.ways import STEP_M
from tests.simulator.streets import scenario, straight_street


def traffic(count: int) -> Scenario:
    cars = {"id": "car", "category": "car", "count": count, "behaviour": {"kind": "idm"}}
    return scenario(cars, ego={"speed_mps": 8.0})


def try_one_by_one(street: Street, ego: EgoState, count: int, seed: int) -> dict[str, tuple[float, float, float]]:
    """Poses of the agents that find room, by scalar arithmetic in the order of the draws."""
    vehicle, behaviour = street.vehicle, Idm(kind="idm")
    middle = (ego.x_m + vehicle.rear_axle_to_center_m * math.cos(ego.yaw_rad),
              ego.y_m + vehicle.rear_axle_to_center_m * math.sin(ego.yaw_rad))  # fmt: skip
    taken = [(*middle, ego.yaw_rad, 0.5 * vehicle.length_m, 0.5 * vehicle.width_m)]
    places, found, ways = [], {}, {}
    for lane in sorted(street.road_map.lanes_of(("drive",)), key=lambda lane: lane.lane_id):
        for point, along in zip(lane.center_m, lane.along_m):
            inside = bool(street.is_inside(point[None, :2])[0])
            if inside and math.hypot(point[0] - ego.x_m, point[1] - ego.y_m) < behaviour.radius_m:
                places.append((lane.lane_id, float(along)))
    for number in range(count):
        name = f"car-{number}"
        length, width = draw_body("car", name, seed).size_m[:2]
        digest = hashlib.sha256(f"place/{seed}/{name}".encode()).digest()
        rng = np.random.default_rng(int.from_bytes(digest[:8], "little"))
        for _ in range(200):
            lane_id, along = places[int(rng.integers(len(places)))]
            lanes = onward_lanes(street.road_map, lane_id, rng)
            if lanes not in ways:
                ways[lanes] = way_along([street.road_map.lanes[one] for one in lanes])
            way, front = ways[lanes], along + length
            at = STEP_M * np.arange(len(way.points))
            x, y, yaw = (float(np.interp(front - 0.5 * length, at, line)) for line in (*way.points.T, way.heading_rad))
            gap = 0.8 * behaviour.desired_share * float(np.interp(front, at, way.pace_mps)) + 6.0
            close = (
                abs(math.cos(yaw) * (u - x) + math.sin(yaw) * (v - y)) < gap + half
                and abs(math.cos(yaw) * (v - y) - math.sin(yaw) * (u - x)) < 0.5 * width + max(wide, 1.6)
                for u, v, _, half, wide in taken
            )
            if front < way.length_m and not any(close):
                found[name] = x, y, yaw
                taken.append((x, y, yaw, 0.5 * length, 0.5 * width))
                break
    return found


@pytest.mark.parametrize(("source", "count", "seed"), [(None, 30, 0), (None, 4, 5), ("synth:tiny", 24, 2)])
def test_agents_stand_at_the_first_free_places(source: str | None, count: int, seed: int) -> None:
    street = straight_street() if source is None else open_street(source)
    now = start_simulation(street, traffic(count), seed).now
    expected = try_one_by_one(street, now.ego, count, seed)
    assert len(expected) == count if count == 4 else 4 < len(expected) < count
    assert [agent.agent_id for agent in now.agents] == sorted(expected)
    # In bends an agent stands on a chord of its way. Drawn places are at least half a metre apart.
    poses = np.column_stack([now.states.x_m, now.states.y_m, now.states.yaw_rad])
    np.testing.assert_allclose(poses, [expected[agent.agent_id] for agent in now.agents], rtol=0.0, atol=0.05)


def test_walls_are_those_of_rays_against_all_surfaces() -> None:
    street = open_street("synth:tiny")
    assert street.drive is not None
    model, names = street.drive.world.model, set()
    for point in np.random.default_rng(1).uniform(-55.0, 55.0, (60, 2)):
        above = np.array([*point, float(street.ground.height_m(point[:1], point[1:])[0]) + 80.0])
        distance, index = cast_rays(model, above, np.array([[0.0, 0.0, -1.0]]))
        labels = np.concatenate([model.faces["label"], model.rounds["label"]])
        label = Label(int(labels[index[0]])) if distance[0] <= 79.6 else None
        expected = label.name.lower() if label in (Label.BUILDING, Label.WALL) else None
        assert Walls.of(street).find(point[None]) == expected
        names.add(expected)
    assert len(names) > 1
