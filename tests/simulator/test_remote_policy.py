"""Policies behind gRPC: what a driver gets, what its answers do, and how its failures end a rollout."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import grpc
import numpy as np
import pytest

from hybridworldsim.simulator.policy_registry import make_policy
from hybridworldsim.simulator.remote.driver_file import DriverFile, read_driver_file
from hybridworldsim.simulator.remote.messages import wire
from hybridworldsim.simulator.remote.policy import RemotePolicy
from hybridworldsim.simulator.renderers.protocol import rig_cameras
from hybridworldsim.simulator.rollout.run import RolloutResult, run_rollout
from mirror.errors import SchemaError, UsageError
from mirror.metrics.safety import read_state_log
from mirror.schema.rollout import STATES_FILE, read_rollout
from tests.simulator.drivers import Driver, serving, straight_on
from tests.simulator.requests import STREET, request
from tests.simulator.streets import LANE_M, scenario

MAPPED = DriverFile(cameras={"rear": "camera_rear_tele_30fov"}, deadline_s=20.0)


def drive(driver: Driver, out: Path, file: DriverFile = MAPPED, **more: object) -> RolloutResult:
    with serving(driver):
        chosen = {"scenario": scenario(duration_s=1.0), **more}
        cameras = rig_cameras(STREET, tuple(STREET.rig), 48)
        return run_rollout(request(RemotePolicy(driver.address, file), cameras=cameras, **chosen), out)


def test_a_driver_on_the_wire_drives_and_gets_all_observations_before_it_is_asked(tmp_path: Path) -> None:
    driver = Driver(straight_on(7.0), lambda name: time.sleep(0.003) if name.startswith("submit") else None)
    recorded = scenario(ego={"start": {"kind": "recorded", "after_s": 2.0}}, duration_s=4.0, seed=7)
    result = drive(driver, tmp_path / "run", scenario=recorded)
    assert result.error is None
    log = read_state_log(tmp_path / "run" / STATES_FILE)
    assert log.vx_mps[-1, 0] == pytest.approx(7.0, abs=0.05)
    names = [name for name, _ in driver.calls]
    assert names[0] == "start_session" and names[-1] == "close_session"
    for step in range(40):
        part = names[1 + 4 * step : 5 + 4 * step]
        assert set(part[:3]) == {"submit_egomotion_observation", "submit_route", "submit_image_observation"}
        assert part[3] == "drive"
    session = driver.got("start_session")[0]
    assert session.random_seed == 7
    assert not session.HasField("debug_info")
    assert {r.session_uuid for _, r in driver.calls} == {session.session_uuid} and len(session.session_uuid) == 32
    (camera,) = session.rollout_spec.vehicle.available_cameras
    assert camera.logical_id == camera.intrinsics.logical_id == "camera_rear_tele_30fov"
    assert (camera.intrinsics.resolution_w, camera.intrinsics.resolution_h) == (48, 27)
    assert camera.intrinsics.opencv_pinhole_param.focal_length_x == pytest.approx(30.0)
    assert (camera.rig_to_camera.vec.x, camera.rig_to_camera.vec.z) == (-0.5, 1.5)


def test_stamps_egomotion_route_and_images_are_those_of_the_step(tmp_path: Path) -> None:
    driver = Driver(straight_on(10.0))
    drive(driver, tmp_path / "run")
    log = read_state_log(tmp_path / "run" / STATES_FILE)
    motion, routes = driver.got("submit_egomotion_observation"), driver.got("submit_route")
    images, asked = driver.got("submit_image_observation"), driver.got("drive")
    stamps = (log.stamps_ns[:-1] // 1000).tolist()
    assert [m.trajectory.poses[0].timestamp_us for m in motion] == stamps
    assert [r.route.timestamp_us for r in routes] == stamps
    assert [i.camera_image.frame_end_us for i in images] == [i.camera_image.frame_start_us for i in images] == stamps
    assert [(a.time_now_us, a.time_query_us) for a in asked] == [(s, s + 100_000) for s in stamps]
    assert all(len(m.trajectory.poses) == len(m.dynamic_states) == 1 for m in motion)
    moved = [m.trajectory.poses[0].pose.vec.x for m in motion]
    np.testing.assert_allclose(moved, log.x_m[:-1, 0] - log.x_m[0, 0], atol=1e-5)
    assert motion[-1].dynamic_states[0].linear_velocity.x == pytest.approx(log.vx_mps[-2, 0], abs=1e-5)
    points = np.array([(p.x, p.y, p.z) for p in routes[0].route.waypoints])
    np.testing.assert_allclose(points, np.column_stack([4.0 * np.arange(20), np.zeros((20, 2))]), atol=1e-5)
    decoded = cv2.imdecode(np.frombuffer(images[0].camera_image.image_bytes, np.uint8), cv2.IMREAD_COLOR)
    assert decoded.shape == (27, 48, 3)


def test_turning_egomotion_agrees_with_differences_of_the_poses(tmp_path: Path) -> None:
    def turning(number: int, driver: Driver, context: object) -> object:
        response = straight_on(10.0)(number, driver, context)
        for pose in response.trajectory.poses:
            pose.pose.vec.y = 0.002 * (pose.pose.vec.x) ** 2
            yaw = np.arctan(0.004 * pose.pose.vec.x)
            pose.pose.quat.w, pose.pose.quat.z = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
        return response

    driver = Driver(turning)
    drive(driver, tmp_path / "run", scenario=scenario(duration_s=2.0))
    motion = driver.got("submit_egomotion_observation")
    yaws = np.array(
        [2.0 * np.arctan2(m.trajectory.poses[0].pose.quat.z, m.trajectory.poses[0].pose.quat.w) for m in motion]
    )
    rates = np.array([m.dynamic_states[0].angular_velocity.z for m in motion])
    speeds = np.array([m.dynamic_states[0].linear_velocity.x for m in motion])
    sideways = np.array([m.dynamic_states[0].linear_acceleration.y for m in motion])
    assert np.abs(rates).max() > 0.02
    # The steering angle moves at its greatest rate at first, and not over whole steps.
    np.testing.assert_allclose(np.diff(yaws)[6:] / 0.1, 0.5 * (rates[1:] + rates[:-1])[6:], atol=2e-3)
    np.testing.assert_allclose(sideways, rates * speeds, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    "start",
    [
        {"start": {"kind": "recorded", "after_s": 2.0}},
        {"speed_mps": 8.0, "start": {"kind": "lane", "lane": "fast", "along_m": 66.0}},
    ],
)
def test_without_a_plan_the_ego_follows_the_recording_or_its_route(tmp_path: Path, start: dict) -> None:
    driver = Driver(lambda number, driver, context: wire().DriveResponse())
    result = drive(driver, tmp_path / "run", scenario=scenario(ego=start, duration_s=3.0))
    assert result.error is None
    log = read_state_log(tmp_path / "run" / STATES_FILE)
    np.testing.assert_allclose(log.x_m[:, 0] - log.rear_axle_to_center_m, 66.0 + 8.0 * log.times_s, atol=0.05)
    np.testing.assert_allclose(log.y_m[:, 0], -0.5 * LANE_M, atol=0.01)


def test_f_theta_cameras_and_png_are_sent_where_the_file_says_so(tmp_path: Path) -> None:
    path = tmp_path / "driver.toml"
    path.write_text('lens = "f_theta"\nimage_format = "png"\n[cameras]\nfront_wide = "camera_front_wide_120fov"\n')
    driver = Driver(straight_on(10.0))
    drive(driver, tmp_path / "run", read_driver_file(path), scenario=scenario(duration_s=0.2))
    (camera,) = driver.got("start_session")[0].rollout_spec.vehicle.available_cameras
    assert camera.intrinsics.WhichOneof("camera_param") == "ftheta_param"
    assert driver.got("submit_image_observation")[0].camera_image.image_bytes.startswith(b"\x89PNG")


def silent(number: int, driver: Driver, context: grpc.ServicerContext) -> object:
    if number == 3:
        time.sleep(3.0)
    return straight_on(10.0)(number, driver, context)


def refusing(number: int, driver: Driver, context: grpc.ServicerContext) -> object:
    if number == 3:
        context.abort(grpc.StatusCode.FAILED_PRECONDITION, "no\nmap")
    return straight_on(10.0)(number, driver, context)


def changed(change) -> object:
    def answer(number: int, driver: Driver, context: object) -> object:
        response = straight_on(10.0)(number, driver, context)
        if number == 3:
            change(response)
        return response

    return answer


def end(response: object) -> None:
    response.terminate_session = True


def spoil(response: object) -> None:
    response.trajectory.poses[5].pose.vec.x = np.nan


def untwist(response: object) -> None:
    response.trajectory.poses[5].pose.quat.w = 0.0


def past(response: object) -> None:
    del response.trajectory.poses[1:]


def shuffle(response: object) -> None:
    response.trajectory.poses[5].timestamp_us = response.trajectory.poses[4].timestamp_us


def flood(response: object) -> None:
    response.trajectory.poses.extend(list(response.trajectory.poses) * 50)


def burst(response: object) -> None:
    response.debug_info.unstructured_debug_info = b"x" * (5 << 20)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (silent, "drive: no answer within 0.5 s"),
        (refusing, "drive: FAILED_PRECONDITION: no map"),
        (changed(end), "the driver ended the session"),
        (changed(spoil), "drive, pose 5"),
        (changed(untwist), "drive, pose 5"),
        (changed(past), "later than the observation"),
        (changed(shuffle), "increasing stamps"),
        (changed(flood), "2091 poses"),
        (changed(burst), "RESOURCE_EXHAUSTED"),
    ],
)
def test_a_driver_that_fails_ends_the_rollout_by_name_with_a_complete_log(tmp_path: Path, answer, reason: str) -> None:
    driver = Driver(answer)
    begin = time.monotonic()
    result = drive(driver, tmp_path / "run", MAPPED.model_copy(update={"deadline_s": 0.5}))
    assert result.error is not None
    rollout = read_rollout(tmp_path / "run")
    assert rollout.ending == ("deadline" if answer is silent else "policy") and rollout.steps == 3
    assert rollout.reason is not None and reason in rollout.reason and "policy 'test'" in rollout.reason
    assert len(read_state_log(tmp_path / "run" / STATES_FILE).stamps_ns) == 4
    assert time.monotonic() - begin < 4.0


def test_nobody_at_the_address_ends_the_rollout_before_its_first_step(tmp_path: Path) -> None:
    policy = RemotePolicy("grpc://127.0.0.1:1", MAPPED)
    result = run_rollout(request(policy, video=("rear",)), tmp_path / "run")
    assert result.error is not None and "start_session: 127.0.0.1:1 does not answer" in str(result.error)
    assert read_rollout(tmp_path / "run").steps == 0
    assert len(read_state_log(tmp_path / "run" / STATES_FILE).stamps_ns) == 1


@pytest.mark.parametrize("address", ["grpc://", "grpc://host", "grpc://host:0", "grpc://host:70000", "http://host:80"])
def test_addresses_that_are_none_are_refused(address: str) -> None:
    with pytest.raises(UsageError, match="grpc://HOST:PORT"):
        make_policy(address)


def test_a_file_with_an_unknown_key_and_a_file_for_a_local_policy_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "driver.toml"
    path.write_text("quality = 950\n")
    with pytest.raises(SchemaError, match="quality"):
        read_driver_file(path)
    with pytest.raises(UsageError, match="cannot be read"):
        read_driver_file(tmp_path / "none.toml")
    with pytest.raises(UsageError, match="runs in this process"):
        make_policy("idm", DriverFile())
