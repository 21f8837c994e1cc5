"""The messages of the wire, and lenses as messages."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from google.protobuf import descriptor_pool

from hybridworldsim.simulator.remote import messages as module
from hybridworldsim.simulator.remote.lenses import FIT_PX, from_spec, to_spec
from hybridworldsim.simulator.remote.messages import Messages, wire
from hybridworldsim.simulator.remote.poses import flat, from_pose, to_flat_pose, to_pose
from mirror.errors import UsageError
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera

PINHOLE = Camera("pinhole", 1920, 1080, 560.0, 600.0, 963.0, 538.0)
FISHEYE = Camera("kannala_brandt", 1280, 960, 400.0, 410.0, 640.0, 480.0, (0.05, -0.01, 0.002, -0.0003))
F_THETA = Camera("f_theta", 1920, 1080, 1.0, 1.0, 960.0, 540.0, (0.0, 900.0, 10.0, -30.0, 2.0))
RATIONAL = Camera("rational", 1280, 960, 800.0, 810.0, 640.0, 480.0, (-0.1, 0.02, 1e-3, -2e-3, 0.001, 0.01, 0.0, 0.0))
BROWN = Camera("brown_conrady", 1280, 960, 800.0, 810.0, 640.0, 480.0, (-0.1, 0.02, 1e-3, -2e-3, 0.001))


def misses_px(camera: Camera, other: Camera) -> float:
    pixels = np.random.default_rng(0).uniform((0.0, 0.0), (camera.width_px, camera.height_px), (4000, 2))
    rays = camera.unproject(pixels)
    assert rays.valid.mean() > 0.99
    return float(np.abs(other.project(rays.direction[rays.valid]).uv_px - pixels[rays.valid]).max())


def test_the_compiled_messages_are_those_of_the_proto_files(tmp_path) -> None:
    protoc = pytest.importorskip("grpc_tools.protoc")
    folder = module.Path(module.__file__).parent
    out = tmp_path / "set"
    names = ("common.proto", "sensorsim.proto", "egodriver.proto")
    assert protoc.main(["protoc", f"-I{folder / 'protos'}", f"--descriptor_set_out={out}", *names]) == 0
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    committed = FileDescriptorSet.FromString((folder / "messages.binpb").read_bytes())
    assert FileDescriptorSet.FromString(out.read_bytes()) == committed


def test_the_messages_are_in_a_pool_of_their_own() -> None:
    first, second = Messages(), Messages()
    assert first.Vec3 is not second.Vec3
    with pytest.raises(KeyError):
        descriptor_pool.Default().FindMessageTypeByName("egodriver.DriveRequest")
    with pytest.raises(AttributeError):
        _ = first.LidarRenderRequest


@pytest.mark.parametrize("first", ["mirror", "other"])
def test_a_package_with_the_same_names_in_the_default_pool_can_be_imported_too(first: str) -> None:
    command = [sys.executable, "-m", "tests.simulator.other_package", first]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "both\n"


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE, F_THETA, RATIONAL, BROWN], ids=lambda camera: camera.model)
def test_cameras_come_back_from_their_messages(camera: Camera) -> None:
    spec = wire().CameraSpec.FromString(to_spec(camera, "front").SerializeToString())
    assert spec.logical_id == "front" and spec.shutter_type == 5
    assert misses_px(camera, from_spec(spec)) < 1e-9


@pytest.mark.parametrize(
    "camera",
    [PINHOLE, PINHOLE.resized(240, 135), PINHOLE.resized(3840, 2160), FISHEYE, F_THETA],
    ids=["1920", "240", "3840", "fisheye", "f_theta"],
)
def test_f_theta_polynomials_fit_in_both_directions(camera: Camera) -> None:
    spec = to_spec(camera, "front", "f_theta")
    assert misses_px(camera, from_spec(spec)) <= FIT_PX
    lens = spec.ftheta_param
    pixels = np.random.default_rng(1).uniform((0.0, 0.0), (camera.width_px, camera.height_px), (2000, 2))
    offset = (pixels - (lens.principal_point_x, lens.principal_point_y)) / (lens.linear_cde.linear_c, 1.0)
    radius = np.hypot(*offset.T)
    angle = np.polynomial.polynomial.polyval(radius, np.array(lens.pixeldist_to_angle_poly))
    rays = np.column_stack([offset / radius[:, None] * np.sin(angle)[:, None], np.cos(angle)])
    assert np.hypot(*(camera.project(rays).uv_px - pixels).T).max() <= FIT_PX
    assert angle.max() <= lens.max_angle + 1e-3
    spec.ftheta_param.reference_poly = lens.PIXELDIST_TO_ANGLE
    assert misses_px(camera, from_spec(spec)) <= 2.0 * FIT_PX


def windshield(spec) -> None:
    spec.bivariate_windshield_model_param.reference_poly = 1


def prism(spec) -> None:
    spec.opencv_pinhole_param.thin_prism_coeffs[:] = (0.1, 0.0, 0.0, 0.0)


def no_lens(spec) -> None:
    spec.ClearField("opencv_pinhole_param")


def no_size(spec) -> None:
    spec.ClearField("resolution_w")


def bad_focal(spec) -> None:
    spec.opencv_pinhole_param.focal_length_x = np.nan


def skewed(spec) -> None:
    spec.CopyFrom(to_spec(F_THETA, "front"))
    spec.ftheta_param.linear_cde.linear_d = 0.01


def no_polynomial(spec) -> None:
    spec.ftheta_param.max_angle = 1.0


def falling(spec) -> None:
    spec.ftheta_param.pixeldist_to_angle_poly[:] = (0.0, -0.01)


@pytest.mark.parametrize("change", [windshield, prism, no_lens, no_size, bad_focal, skewed, no_polynomial, falling])
def test_lenses_that_cannot_be_rendered_are_refused(change) -> None:
    spec = to_spec(PINHOLE, "front")
    change(spec)
    with pytest.raises(UsageError):
        from_spec(spec)


def test_a_distorted_plane_is_not_described_by_an_angle() -> None:
    with pytest.raises(UsageError, match="no f-theta polynomial"):
        to_spec(BROWN, "front", "f_theta")


def test_poses_come_back_to_single_precision() -> None:
    rng = np.random.default_rng(0)
    poses = Poses.exp(rng.normal(size=(50, 6)))
    for number in range(50):
        back = from_pose(wire().Pose.FromString(to_pose(poses[number]).SerializeToString()), "here")
        np.testing.assert_allclose(back.matrix(), poses[number].matrix(), atol=1e-6)
    for yaw in (-3.0, 0.0, 1.0, 3.1):
        np.testing.assert_allclose(flat([to_flat_pose(1.0, -2.0, yaw)], ["here"]), [(1.0, -2.0, yaw)], atol=1e-6)
    with pytest.raises(UsageError, match="quaternion of length 1"):
        from_pose(wire().Pose(), "here")
