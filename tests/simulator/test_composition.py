"""Composition of agents: what hides them and what does not, edges, contact shadows; the layer's geometry."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pytest

from hybridworldsim.simulator.agents.bodies import body_of_size, draw_body
from hybridworldsim.simulator.agents.states import Agent, AgentStates
from hybridworldsim.simulator.ego.vehicle import EgoState
from hybridworldsim.simulator.renderers.agent_layer import AgentImage, AgentLayer
from hybridworldsim.simulator.renderers.compositing import (
    CELL_M,
    add_contact_shadows,
    compose,
    free_space,
    hiding_depth,
)
from hybridworldsim.simulator.renderers.protocol import ego_pose, rig_cameras
from hybridworldsim.simulator.world import Snapshot
from mirror.geometry import project_boxes
from mirror.synth.light.condition import Condition
from mirror.synth.light.sun import instant_of
from tests.simulator.streets import EGO_R_CAMERA, straight_street

LENS = np.array([50.0, 50.0, 20.0, 15.0])
CAMERA = np.array([0.0, 0.0, 1.5])
GRAY = np.full((30, 40, 3), 100, np.uint8)


def agents_at(depth: float, alpha: float = 1.0) -> AgentImage:
    share = np.full((30, 40), alpha, np.float32)
    return AgentImage(
        np.full((30, 40, 3), 200, np.uint8), share, np.full((30, 40), depth, np.float32), np.zeros((30, 40), np.int32)
    )


def composed(
    street_m: float, agent_m: float, ring: np.ndarray | None = None, alpha: float = 1.0, covered: float | None = None
):
    """By default the street is a surface: it covers all before it, or nothing."""
    rings = [] if ring is None else [ring]
    free = free_space(rings, (0.0, 0.0), 50.0)
    depth = np.full((30, 40), street_m, np.float32)
    agents = agents_at(agent_m, alpha)
    surface = ((depth > 0.0) & (depth < hiding_depth(agents))).astype(np.float32)
    share = surface if covered is None else np.full((30, 40), covered, np.float32)
    return compose(GRAY, depth, share, agents, LENS, EGO_R_CAMERA, CAMERA, free)


def test_the_nearer_one_is_seen() -> None:
    image, shown = composed(street_m=20.0, agent_m=10.0)
    assert shown.all() and (image == 200).all()
    image, shown = composed(street_m=10.0, agent_m=20.0)
    assert not shown.any() and (image == 100).all()


def test_mist_hides_an_agent_only_where_it_covers_most() -> None:
    """Whatever the mean depth is: mist before a wall has one between the two."""
    for street_m in (8.0, 30.0):
        assert composed(street_m, agent_m=10.0, covered=0.7)[1].all()
        assert not composed(street_m, agent_m=10.0, covered=0.8)[1].any()


def test_nothing_hides_an_agent_where_the_street_is_empty() -> None:
    assert composed(street_m=0.0, agent_m=20.0)[1].all()


def test_nothing_fixed_stands_on_the_road() -> None:
    road = np.array([(0.0, -50.0), (40.0, -50.0), (40.0, 50.0), (0.0, 50.0)])
    assert composed(street_m=10.0, agent_m=20.0, ring=road)[1].all()
    beside = road + np.array([0.0, 52.0])
    assert not composed(street_m=10.0, agent_m=20.0, ring=beside)[1][:, 20:].any()


def test_edges_are_blended_by_their_share() -> None:
    image, shown = composed(street_m=20.0, agent_m=10.0, alpha=0.25)
    assert (image == 125).all()
    assert not shown.any()


def test_the_grid_of_free_space_has_the_area_of_the_rings() -> None:
    ring = np.array([(-10.0, -5.0), (10.0, -5.0), (10.0, 5.0), (-10.0, 5.0)])
    free = free_space([ring], (3.0, -2.0), 30.0)
    assert abs(free.is_free.sum() * CELL_M**2 - 200.0) < 0.04 * 200.0


def test_contact_shadows_darken_the_ground_beneath_and_nothing_else() -> None:
    rows = np.arange(30)[:, None] + 0.5
    below = np.maximum((rows - LENS[3]) / LENS[1], 1e-9)
    depth = np.where(rows > LENS[3], CAMERA[2] / below, 0.0).astype(np.float32) * np.ones((1, 40), np.float32)
    image = GRAY.copy()
    add_contact_shadows(image, depth, LENS, EGO_R_CAMERA, CAMERA, np.array([[8.0, 0.0, 0.0, 0.0, 2.0, 0.9]]))
    dark = image[..., 0] < 100
    column, row = 20, int(LENS[3] + LENS[1] * CAMERA[2] / 8.0)
    assert image[row, column, 0] < 40
    assert not dark[:15].any()
    u, v = np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5)
    with np.errstate(divide="ignore"):
        x = LENS[1] * CAMERA[2] / np.maximum(v - LENS[3], 1e-9)
    y = -(u - LENS[2]) / LENS[0] * x
    far = (np.abs(x - 8.0) > 3.0) | (np.abs(y) > 1.9)
    assert not (dark & far).any()
    high = GRAY.copy()
    add_contact_shadows(high, depth, LENS, EGO_R_CAMERA, CAMERA, np.array([[8.0, 0.0, 1.0, 0.0, 2.0, 0.9]]))
    assert (high == 100).all()


def test_agents_are_drawn_within_their_boxes() -> None:
    street = straight_street()
    body = draw_body("car", "seven", 0)
    agent = Agent("seven", "car", body.size_m, body)
    states = AgentStates(
        np.array([62.0]), np.array([1.0]), np.array([0.4]), np.zeros(1), np.zeros(1), np.zeros(1), np.ones(1, np.bool_)
    )
    ego = EgoState(50.0, -1.75, 0.0, 8.0)
    snapshot = Snapshot(0, 0.0, 0, street.vehicle, ego, (agent,), states, {})
    cameras = rig_cameras(street, ("front_wide", "rear"), 192)
    condition = Condition(instant_of("2025-06-21", "day", 0.0, 45.0), "day", "clear")
    layer = AgentLayer(street, condition, (agent,))
    instant = layer.at(snapshot)
    pose = ego_pose(street, snapshot) @ cameras["front_wide"].ego_SE3_camera
    drawn = layer.draw(instant, cameras["front_wide"].camera, pose)
    assert drawn is not None
    v, u = np.nonzero(drawn.alpha > 0.5)
    world_SE3_box = street.ground.place(62.0, 1.0, 0.4, 2.7, 1.4).world_SE3_body()
    lifted = type(world_SE3_box)(
        world_SE3_box.rotation, world_SE3_box.translation + np.array([0.0, 0.0, 0.5 * body.size_m[2]])
    )
    box = project_boxes(cameras["front_wide"].camera, pose.inverse() @ lifted, np.array([body.size_m])).bounds_px[0]
    assert np.abs(np.array([u.min(), v.min(), u.max() + 1, v.max() + 1]) - box).max() < 4.0
    assert u.min() >= box[0] - 1.0 and v.min() >= box[1] - 1.0
    assert abs(np.median(drawn.depth_m[drawn.alpha > 0.5]) - 9.0) < 2.5
    assert (drawn.number[drawn.alpha > 0.5] == 0).all()
    assert drawn.rgb[drawn.alpha > 0.5].std() > 5.0
    behind = ego_pose(street, snapshot) @ cameras["rear"].ego_SE3_camera
    assert layer.draw(instant, cameras["rear"].camera, behind) is None


def test_thin_parts_have_the_place_of_their_agent() -> None:
    """Rays through the centres of these pixels pass between the spokes of a bicycle."""
    street, body = straight_street(), draw_body("cyclist", "two", 0)
    agent = Agent("two", "cyclist", body.size_m, body)
    states = AgentStates(
        np.array([66.0]), np.array([-1.0]), np.array([1.3]), np.zeros(1), np.zeros(1), np.zeros(1), np.ones(1, np.bool_)
    )
    snapshot = Snapshot(0, 0.0, 0, street.vehicle, EgoState(50.0, -1.75, 0.0, 8.0), (agent,), states, {})
    place = rig_cameras(street, ("front_wide",), 480)["front_wide"]
    layer = AgentLayer(street, Condition(instant_of("2025-06-21", "day", 0.0, 45.0), "day", "clear"), (agent,))
    drawn = layer.draw(layer.at(snapshot), place.camera, ego_pose(street, snapshot) @ place.ego_SE3_camera)
    assert drawn is not None
    seen = drawn.alpha > 0.0
    assert (np.isfinite(drawn.depth_m) == seen).all() and (drawn.number[seen] == 0).all()
    assert np.abs(drawn.depth_m[seen] - 14.5).max() < 1.5


def test_a_body_is_chosen_by_category_and_size() -> None:
    long = body_of_size("truck", (9.0, 2.5, 3.4))
    assert long.category == "truck"
    assert math.isclose(long.size_m[0], 9.0, abs_tol=2.5)
    assert body_of_size("bicycle", (1.8, 0.6, 1.7)).category in ("bicycle", "cyclist")


@pytest.mark.parametrize(("light", "lit"), [("night", True), ("day", False)])
def test_headlights_of_the_ego_light_agents_in_the_dark(light: Literal["day", "night"], lit: bool) -> None:
    """Two images from one place, with the ego facing the agent and with the ego turned away from it."""
    street = straight_street()
    body = draw_body("van", "seven", 0)
    agent = Agent("seven", "van", body.size_m, body)
    states = AgentStates(
        np.array([62.0]), np.array([-1.75]), np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(1), np.ones(1, np.bool_)
    )
    camera = rig_cameras(street, ("front_wide",), 192)["front_wide"]
    layer = AgentLayer(street, Condition(instant_of("2025-06-21", light, 0.0, 45.0), light, "clear"), (agent,))
    facing, away = (
        Snapshot(0, 0.0, 0, street.vehicle, EgoState(50.0, -1.75, yaw, 8.0), (agent,), states, {})
        for yaw in (0.0, math.pi)
    )
    pose = ego_pose(street, facing) @ camera.ego_SE3_camera
    drawn = [layer.draw(layer.at(snapshot), camera.camera, pose) for snapshot in (facing, away)]
    means = [float(one.rgb[one.alpha > 0.5].mean()) for one in drawn if one is not None]
    assert means[0] > 1.5 * means[1] if lit else means[0] == means[1]
