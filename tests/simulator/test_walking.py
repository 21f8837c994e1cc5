"""Served pedestrians walk: their steps follow where they are placed, as in a rollout."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from hybridworldsim.simulator.agents.bodies import draw_body
from hybridworldsim.simulator.agents.replay import RecordedTrack, ReplayedAgents
from hybridworldsim.simulator.agents.states import Agent, AgentStates, Boxes
from hybridworldsim.simulator.remote.messages import wire
from hybridworldsim.simulator.remote.poses import to_flat_pose
from hybridworldsim.simulator.remote.scenes import ServedScene
from hybridworldsim.simulator.remote.service import SensorService
from hybridworldsim.simulator.remote.walking import RecordedLine
from hybridworldsim.simulator.renderers.protocol import CameraView, LiveUsers, Renderer
from hybridworldsim.simulator.world import Snapshot
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from tests.simulator.served import pair, request
from tests.simulator.streets import straight_street

BODY = draw_body("pedestrian", "walker", 0)
TIMES = np.arange(0.0, 20.0, 0.1)


def walker(points: np.ndarray) -> RecordedTrack:
    course = np.gradient(points, axis=0)
    poses = np.column_stack([points, np.arctan2(course[:, 1], course[:, 0])])
    return RecordedTrack(Agent("walker", "pedestrian", BODY.size_m, BODY), TIMES[: len(points)], poses)


CURVE = walker(np.column_stack([10.0 + 5.0 * np.sin(0.25 * TIMES), 8.0 - 5.0 * np.cos(0.25 * TIMES)]))


class Recorder(Renderer):
    """Draws nothing and keeps the states that it gets."""

    name = "recorder"
    states: AgentStates | None = None

    def _draw_views(self, snapshot: Snapshot, views: Sequence[CameraView]) -> dict[str, np.ndarray]:
        self.states = snapshot.states
        return {view.name: np.zeros((view.camera.height_px, view.camera.width_px, 3), np.uint8) for view in views}


def served(track: RecordedTrack) -> tuple[ServedScene, Recorder]:
    street = straight_street()
    renderer = Recorder(street, {})
    return ServedScene("scene", street, (track,), renderer), renderer


def test_steps_and_speed_on_the_recorded_line_are_those_of_a_rollout() -> None:
    scene, renderer = served(CURVE)
    replayed = ReplayedAgents([CURVE], 0.0, 0.1, 150)
    view = CameraView("a", Camera("pinhole", 8, 8, 8.0, 8.0, 4.0, 4.0), Poses.identity(1))
    for step in (1, 60, 149):
        expected = replayed.advance(step - 1, Boxes(np.zeros((1, 7))), np.zeros(0, np.int64))
        place = np.array([expected.x_m[0], expected.y_m[0], expected.yaw_rad[0], np.nan])
        scene.render([view], {"walker": place}, 10**8 * step)
        states = renderer.states
        assert states is not None
        for name, tolerance in (("along_m", 1e-9), ("vx_mps", 0.03), ("vy_mps", 0.03)):
            np.testing.assert_allclose(getattr(states, name), getattr(expected, name), atol=tolerance)


def test_a_walk_moves_the_legs_and_a_pause_ends_it() -> None:
    """Bodies of two instants differ in their own frame while somebody walks, and are equal while they stand."""
    scene, renderer = served(CURVE)
    view = CameraView("a", Camera("pinhole", 8, 8, 8.0, 8.0, 4.0, 4.0), Poses.identity(1))
    users = LiveUsers(scene.agents, scene.street.ground)
    shapes = []
    for time_s, speed in ((2.0, np.nan), (2.2, np.nan), (2.0, 0.0), (2.2, 0.0)):
        scene.render([view], {"walker": np.array([*CURVE.at(np.array([time_s]))[0], speed])}, 0)
        assert renderer.states is not None
        users.update(Snapshot(0, 0.0, 0, scene.street.vehicle, None, scene.agents, renderer.states, {}))
        shapes.append(BODY.model_at(users.motions[0].placement).bounds())
    # At 1.25 m/s, 0.2 s are a sixth of a gait cycle: the reach of arms and legs changes by centimetres.
    assert np.abs(np.subtract(shapes[0], shapes[1])).max() > 0.02
    np.testing.assert_array_equal(shapes[2], shapes[3])


@pytest.mark.parametrize(
    ("track", "begin", "step"),
    [
        (walker(np.column_stack([0.1 * np.arange(50), np.zeros(50)])), (4.9, 0.0), (1.0, 0.0)),
        (walker(np.column_stack([0.1 * np.arange(50), np.zeros(50)])), (2.0, 1.0), (0.0, 1.0)),
        (walker(np.column_stack([0.1 * np.arange(50), np.zeros(50)])), (4.0, 0.5), (-1.0, 0.0)),
        (RecordedTrack(CURVE.agent, np.zeros(1), np.array([[3.0, 4.0, 0.0]])), (3.0, 4.0), (0.6, 0.8)),
    ],
    ids=["beyond the end", "away from the line", "against the line", "recorded standing"],
)
def test_nobody_glides_where_nothing_was_recorded(
    track: RecordedTrack, begin: tuple[float, float], step: tuple[float, float]
) -> None:
    """Every metre of a straight way adds a metre to the distance, whatever was recorded."""
    line, yaw = RecordedLine(track), np.arctan2(step[1], step[0])
    places = np.array([*begin]) + np.linspace(0.0, 1.0, 11)[:, None] * np.array(step)
    along = [line.at(np.array([*place, yaw]))[0] for place in places]
    np.testing.assert_allclose(np.diff(along), 0.1, atol=1e-9)


def test_the_speed_is_that_of_the_poses_in_a_request() -> None:
    scene, renderer = served(CURVE)
    service = SensorService({"drive-1": scene})
    x, y, yaw = CURVE.at(np.array([4.0]))[0].tolist()
    for shift_m, expected in ((0.02, 2.0), (0.0, 1.25)):
        moved = pair(
            to_flat_pose(x - shift_m / 2 * np.cos(yaw), y - shift_m / 2 * np.sin(yaw), yaw),
            to_flat_pose(x + shift_m / 2 * np.cos(yaw), y + shift_m / 2 * np.sin(yaw), yaw),
        )
        # The exposure of the request takes 10 ms; equal poses tell no speed, so that the recorded one counts.
        service.render(request(dynamic_objects=[wire().DynamicObject(track_id="walker", pose_pair=moved)]))
        assert renderer.states is not None
        speed = np.hypot(renderer.states.vx_mps[0], renderer.states.vy_mps[0])
        assert speed == pytest.approx(expected, rel=0.01)
