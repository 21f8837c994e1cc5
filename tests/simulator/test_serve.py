"""The service that renders for another simulator: its answers, and what it refuses by a status."""

from __future__ import annotations

import http.client
import socket
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import grpc
import numpy as np
import pytest

from hybridworldsim.simulator.remote.command import Arguments
from hybridworldsim.simulator.remote.lenses import from_spec
from hybridworldsim.simulator.remote.messages import SENSOR_SERVICE, wire
from hybridworldsim.simulator.remote.poses import from_pose, to_flat_pose
from hybridworldsim.simulator.remote.scenes import ServedScene, open_scenes
from hybridworldsim.simulator.remote.server import render_server
from hybridworldsim.simulator.remote.service import Limits
from hybridworldsim.simulator.renderers.protocol import CameraView, Renderer
from hybridworldsim.simulator.renderers.registry import RendererFactory
from hybridworldsim.simulator.world import Snapshot
from mirror.errors import UsageError
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from tests.simulator.served import CALLS, car_at, is_car, pair, pixels, request, sensor_pose, service
from tests.simulator.streets import straight_street

WIDE = Camera("f_theta", 320, 200, 1.0, 1.0, 160.0, 100.0, (0.0, 150.0, 2.0, -6.0))


class Client:
    def __init__(self, port: int) -> None:
        self.channel = grpc.insecure_channel(f"127.0.0.1:{port}", [("grpc.max_receive_message_length", 64 << 20)])

    def raw(self, name: str, data: bytes) -> bytes:
        return self.channel.unary_unary(f"/{SENSOR_SERVICE}/{name}")(data, timeout=20.0)

    def call(self, name: str, **fields: object) -> object:
        request, answer = CALLS[name]
        data = getattr(wire(), request)(**fields).SerializeToString()
        return getattr(wire(), answer).FromString(self.raw(name, data))


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    with render_server(service(), "127.0.0.1", 0) as port:
        yield Client(port)


def render(client: Client, asked: object) -> np.ndarray:
    return pixels(wire().RGBRenderReturn.FromString(client.raw("render_rgb", asked.SerializeToString())).image_bytes)


def test_the_five_calls_of_a_runtime_are_answered(client: Client) -> None:
    version = client.call("get_version")
    assert version.version_id.startswith("mirror-")
    assert (version.grpc_api_version.major, version.grpc_api_version.minor) == (0, 54)
    assert list(client.call("get_available_scenes").scene_ids) == ["drive-1"]
    cameras = {c.logical_id: c for c in client.call("get_available_cameras", scene_id="drive-1").available_cameras}
    assert set(cameras) == {"camera_front_wide_120fov", "camera_rear_tele_30fov"}
    front = cameras["camera_front_wide_120fov"]
    street = straight_street()
    np.testing.assert_allclose(
        from_pose(front.rig_to_camera, "").matrix(), street.rig["front_wide"].ego_SE3_camera.matrix(), atol=1e-6
    )
    assert from_spec(front.intrinsics) == street.rig["front_wide"].camera
    assert not client.call("get_available_ego_masks").ego_mask_metadata
    assert render(client, request()).shape == (200, 320, 3)


def test_an_agent_appears_where_its_pose_projects(client: Client) -> None:
    bare = render(client, request())
    assert not is_car(bare).any()
    seen = is_car(render(client, request(dynamic_objects=[car_at(112.0, -1.75)])))
    rows, columns = np.nonzero(seen)
    # The rear face of the box is 9.75 m ahead of the camera: its sides project to 160 -+ 160 * 0.95 / 9.75.
    assert columns.min() == pytest.approx(160 - 15.6, abs=2.0) and columns.max() == pytest.approx(160 + 15.6, abs=2.0)
    assert rows.max() == pytest.approx(100 + 160 * 1.5 / 9.75, abs=2.0)


def test_poses_are_taken_in_the_middle_of_the_exposure(client: Client) -> None:
    moving = pair(sensor_pose(98.0), sensor_pose(102.0))
    np.testing.assert_array_equal(render(client, request(sensor_pose=moving)), render(client, request()))
    car = wire().DynamicObject(
        track_id="car-1", pose_pair=pair(to_flat_pose(111.0, -1.75, 3.1), to_flat_pose(113.0, -1.75, -3.1))
    )
    expected = render(client, request(dynamic_objects=[car_at(112.0, -1.75, np.pi)]))
    assert np.mean(np.abs(render(client, request(dynamic_objects=[car])).astype(int) - expected)) < 0.5


class Sky(Renderer):
    """Colours are smooth functions of the direction in the world."""

    name = "sky"

    def _draw_views(self, snapshot: Snapshot, views: Sequence[CameraView]) -> dict[str, np.ndarray]:
        return {view.name: np.round(sky(view.camera, view.world_SE3_camera)).astype(np.uint8) for view in views}


def sky(camera: Camera, pose: Poses) -> np.ndarray:
    return 127.0 + 120.0 * np.sin(3.0 * (camera.rays().direction @ pose.matrix()[0, :3, :3].T))


@pytest.mark.parametrize(
    "lens",
    [
        Camera("f_theta", 320, 200, 1.0, 1.0, 160.0, 100.0, (0.0, 150.0, 2.0, -6.0)),
        Camera("kannala_brandt", 320, 200, 150.0, 152.0, 158.0, 103.0, (0.02, -0.01, 0.002, -0.0003)),
        Camera("rational", 320, 200, 200.0, 202.0, 158.0, 103.0, (-0.2, 0.03, 1e-3, -1e-3, 0.0, 0.0, 0.0, 0.0)),
    ],
    ids=lambda lens: lens.model,
)
def test_an_image_of_a_lens_shows_each_direction_where_the_lens_does(lens: Camera) -> None:
    street = straight_street()
    scene = ServedScene("sky", street, (), Sky(street, {}))
    pose = from_pose(sensor_pose(), "")
    image = scene.render([CameraView("a", lens, pose)], {}, 0)["a"]
    inside = lens.rays().direction[..., 2] > np.cos(np.radians(68.0))
    assert inside.mean() > 0.9
    assert np.abs(image - sky(lens, pose))[inside].max() < 1.2


def test_the_resolution_of_the_request_counts(client: Client) -> None:
    small = render(client, request(resolution_w=160, resolution_h=100))
    assert small.shape == (100, 160, 3)
    data = client.raw("render_rgb", request(image_format=2, image_quality=50.0).SerializeToString())
    assert wire().RGBRenderReturn.FromString(data).image_bytes.startswith(b"\xff\xd8")


def test_a_batch_is_what_single_requests_give_and_one_that_fails_spoils_no_other(client: Client) -> None:
    asked = [request(), request(dynamic_objects=[car_at(112.0, -1.75)]), request(scene_id="nowhere"), request(WIDE)]
    items = [wire().BatchRGBRenderRequestItem(camera_name=f"c{n}", request=one) for n, one in enumerate(asked)]
    answer = client.call("batch_render_rgb", items=items)
    assert [item.camera_name for item in answer.items] == ["c0", "c1", "c2", "c3"]
    assert [item.success for item in answer.items] == [True, True, False, True]
    assert "no scene 'nowhere'" in answer.items[2].error_message
    for number in (0, 1, 3):
        np.testing.assert_array_equal(pixels(answer.items[number].result.image_bytes), render(client, asked[number]))


def status(call) -> tuple[grpc.StatusCode, str]:
    with pytest.raises(grpc.RpcError) as error:
        call()
    return error.value.code(), error.value.details()


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("render_lidar", grpc.StatusCode.UNIMPLEMENTED),
        ("render_aggregated", grpc.StatusCode.UNIMPLEMENTED),
        ("get_loaded_scenes", grpc.StatusCode.UNIMPLEMENTED),
        ("get_available_trajectories", grpc.StatusCode.UNIMPLEMENTED),
    ],
)
def test_other_calls_are_unimplemented(client: Client, name: str, code: grpc.StatusCode) -> None:
    assert status(lambda: client.raw(name, b""))[0] == code


def many() -> list:
    return [car_at(0.0, 0.0)] * 1001


@pytest.mark.parametrize(
    ("change", "code", "text"),
    [
        ({"scene_id": "nowhere"}, grpc.StatusCode.NOT_FOUND, "no scene 'nowhere'"),
        ({"insert_ego_mask": True}, grpc.StatusCode.INVALID_ARGUMENT, "insert_ego_mask"),
        ({"image_format": 5}, grpc.StatusCode.INVALID_ARGUMENT, "PNG or JPEG"),
        ({"image_format": 0}, grpc.StatusCode.INVALID_ARGUMENT, "PNG or JPEG"),
        ({"image_quality": np.nan}, grpc.StatusCode.INVALID_ARGUMENT, "image_quality"),
        ({"image_quality": 101.0}, grpc.StatusCode.INVALID_ARGUMENT, "1 to 100"),
        ({"resolution_w": 1 << 20, "resolution_h": 1 << 20}, grpc.StatusCode.INVALID_ARGUMENT, "pixels"),
        ({"camera_intrinsics": None}, grpc.StatusCode.INVALID_ARGUMENT, "0 x 0 px"),
        ({"sensor_pose": None}, grpc.StatusCode.INVALID_ARGUMENT, "sensor_pose"),
        ({"frame_end_us": 1}, grpc.StatusCode.INVALID_ARGUMENT, "ends before it starts"),
        ({"frame_end_us": (1 << 64) - 1}, grpc.StatusCode.INVALID_ARGUMENT, "2262"),
        ({"dynamic_objects": many}, grpc.StatusCode.INVALID_ARGUMENT, "1001 dynamic objects"),
        (
            {"dynamic_objects": lambda: [wire().DynamicObject(track_id="x", pose_pair=pair(to_flat_pose(0, 0, 0)))]},
            grpc.StatusCode.INVALID_ARGUMENT,
            "no road user 'x'",
        ),
    ],
)
def test_requests_that_cannot_be_rendered_are_refused_by_a_status(
    client: Client, change: dict, code: grpc.StatusCode, text: str
) -> None:
    change = {key: value() if callable(value) else value for key, value in change.items()}
    found = status(lambda: render(client, request(**change)))
    assert found[0] == code and text in found[1]
    assert render(client, request()).shape == (200, 320, 3)


def test_bytes_that_are_no_message_and_messages_that_are_too_long_are_refused(client: Client) -> None:
    assert status(lambda: client.raw("render_rgb", b"\x80\x04\x95garbage"))[0] == grpc.StatusCode.INVALID_ARGUMENT
    found = status(lambda: client.raw("render_rgb", bytes(9 << 20)))
    assert found[0] == grpc.StatusCode.RESOURCE_EXHAUSTED


def test_more_images_than_the_limits_are_refused() -> None:
    with render_server(service(Limits(images=2, images_per_s=4.0)), "127.0.0.1", 0) as port:
        client = Client(port)
        items = [wire().BatchRGBRenderRequestItem(camera_name=str(n), request=request()) for n in range(3)]
        found = status(lambda: client.call("batch_render_rgb", items=items))
        assert found[0] == grpc.StatusCode.INVALID_ARGUMENT and "at most 2" in found[1]
        codes = []
        for _ in range(12):
            try:
                render(client, request())
            except grpc.RpcError as error:
                codes.append(error.code())
        assert codes and set(codes) == {grpc.StatusCode.RESOURCE_EXHAUSTED} and len(codes) <= 4


def test_more_pixels_than_the_limits_are_refused_before_they_are_rendered(client: Client) -> None:
    large = {"resolution_w": 4096, "resolution_h": 4096}
    items = [wire().BatchRGBRenderRequestItem(camera_name=str(n), request=request(**large)) for n in range(16)]
    start = time.monotonic()
    found = status(lambda: client.call("batch_render_rgb", items=items))
    assert found[0] == grpc.StatusCode.INVALID_ARGUMENT and f"{1 << 28} pixels in one request" in found[1]
    assert time.monotonic() - start < 5.0
    for size in ({"resolution_w": 1 << 20, "resolution_h": 1}, {"resolution_w": 1, "resolution_h": 9000}):
        found = status(lambda size=size: render(client, request(**size)))  # type: ignore[misc]
        assert found[0] == grpc.StatusCode.INVALID_ARGUMENT and "sides of at most 8192" in found[1]
    with render_server(service(Limits(pixels_per_s=70_000.0)), "127.0.0.1", 0) as port:
        few = Client(port)
        assert render(few, request()).shape == (200, 320, 3)
        render(few, request())
        found = status(lambda: render(few, request()))
    assert found[0] == grpc.StatusCode.RESOURCE_EXHAUSTED and "64000 pixels" in found[1]


def test_web_pages_and_other_machines_get_no_images() -> None:
    """The verb listens on this machine alone, and browsers cannot speak the protocol: it begins with HTTP/2."""
    assert Arguments(source="synth:tiny").host == "127.0.0.1"
    with render_server(service(), Arguments(source="synth:tiny").host, 0) as port:
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", port), timeout=5.0)
        page = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
        page.request("POST", f"/{SENSOR_SERVICE}/get_version", b"\0" * 5, {"Origin": "http://evil.example"})
        with pytest.raises((http.client.HTTPException, OSError)):
            page.getresponse()


def test_a_port_that_is_taken_is_refused_and_so_is_a_street_far_from_its_origin() -> None:
    with render_server(service(), "127.0.0.1", 0) as port, pytest.raises(UsageError, match="nobody can listen"):
        render_server(service(), "127.0.0.1", port).__enter__()
    with pytest.raises(UsageError, match="single precision"):
        open_scenes(replace(straight_street(), middle_m=(5e5, 0.0)), RendererFactory("boxes"))
