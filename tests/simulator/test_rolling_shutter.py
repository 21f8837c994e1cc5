"""Cameras with rolling shutters in the simulator: each line is that of a view at its own time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hybridworldsim.simulator.agents.bodies import draw_body
from hybridworldsim.simulator.agents.states import Agent, AgentStates
from hybridworldsim.simulator.ego.vehicle import Controls, EgoState, VehicleParameters, advance, coast, curvature_of
from hybridworldsim.simulator.policies.protocol import Readout
from hybridworldsim.simulator.remote.lenses import direction_of, to_spec
from hybridworldsim.simulator.remote.messages import wire
from hybridworldsim.simulator.remote.poses import to_flat_pose
from hybridworldsim.simulator.renderers.agent_layer import AgentLayer
from hybridworldsim.simulator.renderers.compositing import add_contact_shadows
from hybridworldsim.simulator.renderers.exact import ExactRenderer
from hybridworldsim.simulator.renderers.protocol import ego_pose, ego_poses, rig_cameras
from hybridworldsim.simulator.renderers.reconstructed import OpenModel, ReconstructedRenderer
from hybridworldsim.simulator.renderers.rolling import cut_bands, line_times, make_shutter, poses_at, reads_columns
from hybridworldsim.simulator.street.of_synth import street_of_drive
from hybridworldsim.simulator.street.street import Street
from hybridworldsim.simulator.world import Snapshot
from mirror.geometry import matrix_from_quaternion
from mirror.geometry.cameras import Camera
from mirror.geometry.rolling_shutter import RollingShutter
from mirror.methods.capabilities import Capabilities
from mirror.methods.model import ModelRenderer
from mirror.protocols.views.view import RenderView, ViewShutter
from mirror.schema.scenario import Scenario
from mirror.synth import Effects, make_drives
from mirror.synth.light.condition import Condition
from mirror.synth.light.sun import instant_of
from mirror.synth.rigs import CameraReadout
from tests.simulator.generated_street import Drawn
from tests.simulator.served import car_at, is_car, pair, pixels, request, sensor_pose, service
from tests.simulator.streets import straight_street

READOUT_S = 0.04
EGO = EgoState(50.0, -1.75, 0.1, 15.0, 2.0, 0.05)
DIRECTIONS = ("top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left")


def test_a_vehicle_coasts_as_it_would_drive() -> None:
    vehicle = VehicleParameters()
    controls = Controls(EGO.acceleration_mps2, curvature_of(vehicle, EGO))
    later = coast(vehicle, EGO, READOUT_S)
    expected = advance(vehicle, EGO, controls, READOUT_S)
    for name, value in vars(expected).items():
        assert getattr(later, name) == pytest.approx(value, abs=1e-12)
    back = coast(vehicle, later, -READOUT_S)
    for name, value in vars(EGO).items():
        assert getattr(back, name) == pytest.approx(value, abs=1e-12)
    braking = replace(EGO, speed_mps=0.02, acceleration_mps2=-2.0)
    assert coast(vehicle, braking, READOUT_S).x_m == pytest.approx(braking.x_m + 1e-4 * np.cos(0.1), abs=1e-6)
    starting = replace(EGO, speed_mps=0.0, acceleration_mps2=2.0)
    assert coast(vehicle, starting, -READOUT_S) == starting


def rolling_street(direction: str) -> Street:
    """The exact street of a vehicle whose forward camera has a rolling shutter, without noise."""
    drive = make_drives("tiny", 0)[1][0]
    effects = Effects.without(["noise", "motion_blur", "exposure", "bloom"])
    readouts = (CameraReadout("front_wide", direction, round(1e9 * READOUT_S)),)  # type: ignore[arg-type]
    vehicle = replace(drive.vehicle, readouts=readouts)
    return street_of_drive(replace(drive, vehicle=vehicle, condition=replace(drive.condition, effects=effects)))


@pytest.mark.parametrize("direction", ["top_to_bottom", "right_to_left"])
def test_lines_of_the_exact_street_are_those_of_the_ego_on_its_way(direction: str) -> None:
    street = rolling_street(direction)
    recording = next(iter(street.recordings.values()))
    x, y, yaw = recording.poses[30]
    body = draw_body("car", "seven", 0)
    agent = Agent("seven", "car", body.size_m, body)
    ego = EgoState(x, y, yaw, 15.0, 1.0, 0.1)
    ahead = np.array([x, y]) + 12.0 * np.array([np.cos(yaw + 0.2), np.sin(yaw + 0.2)])
    states = AgentStates(
        ahead[:1], ahead[1:], np.array([yaw + 1.0]), np.array([3.0]), np.array([9.0]), np.zeros(1), np.ones(1, np.bool_)
    )
    now = Snapshot(0, 3.0, recording.start_ns + 3_000_000_000, street.vehicle, ego, (agent,), states, {})
    condition = street.drive.condition  # type: ignore[union-attr]
    scenario = Scenario(name="rolling", light=condition.light, weather=condition.weather)
    cameras = rig_cameras(street, ("front_wide",), 128)
    rolling = ExactRenderer(street, scenario, now, cameras, 0)
    still = ExactRenderer(street, scenario, now, {"front_wide": replace(cameras["front_wide"], readout=None)}, 0)
    image, shown = rolling.render(now, ["front_wide"])["front_wide"], rolling.agent_masks()["front_wide"]
    middle = still.render(now, ["front_wide"])["front_wide"]
    readout = cameras["front_wide"].readout
    assert readout is not None and readout.direction == direction
    lines = image.shape[1 if direction == "right_to_left" else 0]
    changed = []
    for line in (0, lines // 3, 2 * lines // 3, lines - 1):
        share = line / (lines - 1) if direction == "top_to_bottom" else 1.0 - line / (lines - 1)
        offset_s = 1e-9 * (readout.first_ns + share * (readout.last_ns - readout.first_ns))
        moved = replace(
            states, x_m=states.x_m + offset_s * states.vx_mps, y_m=states.y_m + offset_s * states.vy_mps
        )  # fmt: skip
        there = replace(now, ego=coast(street.vehicle, ego, offset_s), states=moved)
        expected = still.render(there, ["front_wide"])["front_wide"]
        at = (slice(None), line) if direction == "right_to_left" else (line,)
        error = np.abs(image[at].astype(int) - expected[at])
        # the light, also the shadows of what moves, is that of mid-exposure
        assert np.median(error) <= 1.0 and (error.max(axis=-1) > 20).mean() < 0.06
        assert (shown[at] == still.agent_masks()["front_wide"][at]).mean() > 0.97
        changed.append(np.abs(middle[at].astype(int) - expected[at]).mean() - error.mean())
    assert min(changed) > 0.0 and sum(changed) > 2.0
    assert (shown == 0).any()


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_agents_are_drawn_where_each_line_sees_them(direction: str) -> None:
    street, body = straight_street(), draw_body("car", "seven", 0)
    agent = Agent("seven", "car", body.size_m, body)
    states = AgentStates(
        np.array([59.0]), np.array([1.0]), np.array([0.4]), np.array([-8.0]), np.array([-9.0]), np.zeros(1),
        np.ones(1, np.bool_),
    )  # fmt: skip
    now = Snapshot(0, 2.0, 0, street.vehicle, EGO, (agent,), states, {})
    place = rig_cameras(street, ("front_wide",), 96)["front_wide"]
    readout = Readout(direction, -0.5e9 * READOUT_S, 0.5e9 * READOUT_S)  # type: ignore[arg-type]
    ends = ego_poses(street, now, np.array([-0.5, 0.5]) * READOUT_S) @ place.ego_SE3_camera
    shutter = make_shutter(readout, ends)
    layer = AgentLayer(street, Condition(instant_of("2025-06-21", "day", 0.0, 45.0), "day", "clear"), (agent,))
    drawn = layer.draw_lines(layer.at(now), place.camera, shutter, now.time_s)
    middle = layer.draw(layer.at(now), place.camera, ego_pose(street, now) @ place.ego_SE3_camera)
    assert drawn is not None and middle is not None
    times, columns = line_times(shutter, place.camera), reads_columns(shutter)
    assert times[0] == pytest.approx((-0.5 if direction in ("top_to_bottom", "left_to_right") else 0.5) * READOUT_S)
    alpha = drawn.alpha
    seen = np.flatnonzero(alpha.any(axis=0 if columns else 1))
    for line in seen[[0, len(seen) // 2, -1]].tolist():
        offset_s = float(times[line])
        moved = replace(states, x_m=states.x_m - 8.0 * offset_s, y_m=states.y_m - 9.0 * offset_s)
        there = replace(now, ego=coast(street.vehicle, EGO, offset_s), states=moved, time_s=now.time_s + offset_s)
        pose = ego_pose(street, there) @ place.ego_SE3_camera
        exact = layer.draw(layer.at(there), place.camera, pose)
        assert exact is not None
        at = (slice(None), line) if columns else (line,)
        np.testing.assert_allclose(alpha[at], exact.alpha[at], atol=0.12)
        assert np.abs(alpha[at] - exact.alpha[at]).sum() < 0.6
        both = (drawn.alpha[at] > 0.99) & (exact.alpha[at] > 0.99)
        np.testing.assert_allclose(drawn.depth_m[at][both], exact.depth_m[at][both], atol=0.02)
    assert np.abs(alpha - middle.alpha).sum() > 4.0
    assert layer.draw_lines(layer.at(replace(now, states=AgentStates.absent(1))), place.camera, shutter, 2.0) is None


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_bands_are_parts_of_the_image_at_the_time_of_their_lines(direction: str) -> None:
    street = straight_street()
    now = Snapshot(0, 0.0, 0, street.vehicle, EGO, (), AgentStates.absent(0), {})
    place = rig_cameras(street, ("front_wide",), 96)["front_wide"]
    pose = ego_pose(street, now) @ place.ego_SE3_camera
    ends = ego_poses(street, now, np.array([-0.5, 0.5]) * READOUT_S) @ place.ego_SE3_camera
    shutter = make_shutter(Readout(direction, -0.5e9 * READOUT_S, 0.5e9 * READOUT_S), ends)  # type: ignore[arg-type]
    times, counted = line_times(shutter, place.camera), np.zeros((54, 96), int)
    for band in cut_bands(place.camera, pose, shutter):
        counted[band.place] += 1
        lines = np.arange(96)[band.place[1]] if reads_columns(shutter) else np.arange(54)[band.place[0]]
        assert band.offset_s == pytest.approx(times[lines].mean())
        exact = poses_at(shutter, np.array([band.offset_s]))
        np.testing.assert_allclose(band.origin, exact.translation[0])
        np.testing.assert_allclose(band.rotation, matrix_from_quaternion(exact.rotation)[0])
        # the ray of the first pixel of the part is that of the image
        row, column = (np.arange(54)[band.place[0]][0], np.arange(96)[band.place[1]][0])
        first = (0.5 - band.lens[2:]) / band.lens[:2]
        np.testing.assert_allclose(first, ((column + 0.5 - 48.0) / 60.0, (row + 0.5 - 27.0) / 60.0))
    assert (counted == 1).all()
    (whole,) = cut_bands(place.camera, pose, None)
    assert whole.place == (slice(None), slice(None)) and whole.offset_s == 0.0
    image = np.full((54, 96, 3), 100, np.uint8)
    depth = np.full((54, 96), 8.0, np.float32)
    add_contact_shadows(image, depth, whole.lens, whole.rotation, whole.origin, np.zeros((0, 6)))
    assert (image == 100).all()


def rolling_request(direction: str, **more: object) -> object:
    camera = Camera("pinhole", 320, 200, 160.0, 160.0, 160.0, 100.0)
    return request(
        camera_intrinsics=to_spec(camera, "any", direction=direction),  # type: ignore[arg-type]
        frame_end_us=1_700_000_000_040_000, **more,
    )  # fmt: skip


def image_of(served: object, asked: object) -> np.ndarray:
    return pixels(served.render(asked).image_bytes)  # type: ignore[attr-defined]


def test_a_request_with_a_rolling_shutter_is_answered_by_row() -> None:
    """The camera moves by 1.2 m to the left while its rows are exposed from the top: a car leans to the right."""
    served = service()
    moving = pair(sensor_pose(100.0, -2.35), sensor_pose(100.0, -1.15))
    asked = rolling_request("top_to_bottom", sensor_pose=moving, dynamic_objects=[standing_car()])
    image = is_car(image_of(served, asked))
    middle = is_car(image_of(served, rolling_request("global", sensor_pose=moving, dynamic_objects=[standing_car()])))
    rows = np.flatnonzero(image.any(axis=1))
    tested = 0
    for row in rows.tolist():
        share = row / 199.0
        at = sensor_pose(100.0, -2.35 + 1.2 * share)
        still = is_car(image_of(served, request(sensor_pose=pair(at), dynamic_objects=[standing_car()])))
        found, expected = np.flatnonzero(image[row]), np.flatnonzero(still[row])
        if len(found) and len(expected):
            # lines are drawn between corners at whole pixels
            assert abs(found[0] - expected[0]) <= 2 and abs(found[-1] - expected[-1]) <= 2
            tested += 1
    assert tested > 20
    edges = [np.flatnonzero(one[rows[-1]])[[0, -1]].mean() for one in (image, middle)]
    assert edges[0] - edges[1] > 1.5
    upward = is_car(
        image_of(served, rolling_request("bottom_to_top", sensor_pose=moving, dynamic_objects=[standing_car()]))
    )
    assert (upward != image).any()


def standing_car() -> object:
    """A car whose pose does not change; its recorded line stands still too."""
    return car_at(112.0, -1.75)


def test_a_moving_object_is_where_the_rows_see_it() -> None:
    """Camera and car move alike to the left: the edges of the car are those of two that stand."""
    served = service()
    car = wire().DynamicObject(
        track_id="car-1", pose_pair=pair(to_flat_pose(112.0, -2.95, np.pi / 2), to_flat_pose(112.0, -0.55, np.pi / 2))
    )
    moving = pair(sensor_pose(100.0, -2.95), sensor_pose(100.0, -0.55))
    image = is_car(image_of(served, rolling_request("top_to_bottom", sensor_pose=moving, dynamic_objects=[car])))
    still = is_car(image_of(served, request(dynamic_objects=[car_at(112.0, -1.75, np.pi / 2)])))
    rows = np.flatnonzero(image.any(axis=1) & still.any(axis=1))
    assert len(rows) > 20
    ends = [[np.flatnonzero(one[row])[[0, -1]] for row in rows] for one in (image, still)]
    assert np.abs(np.subtract(*ends)).max() <= 2 and np.abs(np.mean(np.subtract(*ends), axis=0)).max() < 0.5


def test_shutters_of_cameras_are_stated_on_the_wire() -> None:
    street = straight_street()
    shutter = RollingShutter("bottom_to_top", 30_000_000, 96, 54)
    rig = dict(street.rig) | {"front_wide": replace(street.rig["front_wide"], shutter=shutter)}
    cameras = rig_cameras(replace(street, rig=rig), ("front_wide", "rear"), 48)
    readout = cameras["front_wide"].readout
    assert readout is not None and readout.direction == "bottom_to_top"
    scaled = shutter.resized(48, 27)
    assert readout.last_ns - readout.first_ns == pytest.approx(scaled.readout_ns, abs=2.0)
    assert cameras["rear"].readout is None
    for direction in ("global", *DIRECTIONS):
        spec = to_spec(street.rig["rear"].camera, "rear", direction=direction)  # type: ignore[arg-type]
        assert direction_of(spec) == direction
    assert direction_of(wire().CameraSpec()) == "global"


def test_poses_of_lines_are_between_those_of_the_ends() -> None:
    street = straight_street()
    now = Snapshot(0, 0.0, 0, street.vehicle, EGO, (), AgentStates.absent(0), {})
    place = rig_cameras(street, ("front_wide",), 96)["front_wide"]
    offsets = np.array([-0.5, -0.2, 0.0, 0.4, 0.5]) * READOUT_S
    exact = ego_poses(street, now, offsets) @ place.ego_SE3_camera
    shutter = ViewShutter(
        direction="top_to_bottom", first_ns=-0.5e9 * READOUT_S, last_ns=0.5e9 * READOUT_S,
        world_SE3_first=exact[:1], world_SE3_last=exact[4:],
    )  # fmt: skip
    between = poses_at(shutter, offsets)
    # a bend and an acceleration are not on the straight line
    assert np.abs((between.inverse() @ exact).log()).max() < 2e-3


class FarStreet:
    """A model of a grey street 200 m away, which keeps the shutters of the views that it renders."""

    def __init__(self) -> None:
        self.seen: list[ViewShutter | None] = []

    def __call__(self, view: RenderView) -> np.ndarray:
        return np.round(255.0 * self.render(view).rgb).astype(np.uint8)

    def render(self, view: RenderView) -> Drawn:
        self.seen.append(view.shutter)
        shape = (view.height_px, view.width_px)
        return Drawn(
            np.full((*shape, 3), 0.4, np.float32), np.ones(shape, np.float32), np.full(shape, 200.0, np.float32)
        )


@pytest.mark.parametrize("direction", ["bottom_to_top", "left_to_right"])
def test_agents_of_a_model_are_composed_by_line(direction: str) -> None:
    street, body = straight_street(), draw_body("car", "seven", 0)
    shutter = RollingShutter(direction, round(1e9 * READOUT_S), 96, 54)  # type: ignore[arg-type]
    rig = {name: replace(camera, shutter=shutter) for name, camera in street.rig.items()}
    street = replace(street, rig=rig)
    agent = Agent("seven", "car", body.size_m, body)
    states = AgentStates(
        np.array([59.0]), np.array([1.0]), np.array([0.4]), np.array([-8.0]), np.array([-9.0]), np.zeros(1),
        np.ones(1, np.bool_),
    )  # fmt: skip
    now = Snapshot(0, 2.0, 0, street.vehicle, EGO, (agent,), states, {})
    method = FarStreet()
    model = OpenModel(
        Path(), street.scene_id, ("drive-1",), ModelRenderer("far", method, Capabilities(renders_depth=True))
    )
    cameras = rig_cameras(street, ("front_wide",), 96)
    renderer = ReconstructedRenderer(model, street, Scenario(name="rolling"), now, cameras)
    image = renderer.render(now, ["front_wide"])["front_wide"]
    (seen,) = method.seen
    assert seen is not None and seen.direction == direction
    drawn = renderer.layer.draw_lines(renderer.layer.at(now), cameras["front_wide"].camera, seen, now.time_s)
    assert drawn is not None
    np.testing.assert_array_equal(renderer.agent_masks()["front_wide"], np.where(drawn.alpha >= 0.5, 0, -1))
    whole = drawn.alpha > 0.999
    assert whole.sum() > 50
    assert np.abs(image[whole].astype(int) - drawn.rgb[whole]).max() <= 1
    bare = drawn.alpha == 0.0
    assert (image[bare] == 102).mean() > 0.9  # the rest are contact shadows
