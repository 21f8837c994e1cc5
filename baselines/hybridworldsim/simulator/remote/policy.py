"""A policy that drives from another process: it serves AlpaSim's ``EgodriverService``."""

from __future__ import annotations

import math
import time
import uuid
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Final

import numpy as np

from hybridworldsim.simulator.ego.vehicle import curvature_of
from hybridworldsim.simulator.policies.protocol import (
    Action,
    LateError,
    NoPlanYet,
    Observation,
    ObservationSpec,
    PlannedTrajectory,
)
from hybridworldsim.simulator.remote.driver_file import DriverFile
from hybridworldsim.simulator.remote.images import encode
from hybridworldsim.simulator.remote.lenses import to_spec
from hybridworldsim.simulator.remote.messages import DRIVER_SERVICE, wire
from hybridworldsim.simulator.remote.poses import flat, to_flat_pose, to_pose, to_us, vector
from mirror.addresses import LAST_PORT, require_answer
from mirror.arrays import Float64
from mirror.errors import UsageError

SCHEME: Final = "grpc://"
SOCKET: Final = "unix:"
_MAX_SENT: Final = 64 << 20
_MAX_RECEIVED: Final = 4 << 20
_CLOSE_S: Final = 1.0
_EVERY: Final = 2
_LEAST_STEP_M: Final = 3.5
_CONNECTION_S: Final = 2.0
DRIVER_CALLS: Final = {
    "start_session": "SessionRequestStatus",
    "close_session": "Empty",
    "submit_image_observation": "Empty",
    "submit_egomotion_observation": "Empty",
    "submit_route": "Empty",
    "drive": "DriveResponse",
}


class RemotePolicy:
    """A policy that sends each observation to a driver, waits for acknowledgements, and asks for a trajectory.

    Poses on the wire are in the frame of the ego at the start of the rollout. Images carry the stamp of the step as the
    begin and the end of their exposure. Nothing that a driver sends is executed or unpickled.

    Args:
        address: ``grpc://HOST:PORT``, or ``unix:PATH`` of a socket; the connection is not encrypted.
        driver: what the driver gets, and its deadline.

    Raises:
        UsageError: the address is not one, or gRPC is not installed.
    """

    privileged = False

    def __init__(self, address: str, driver: DriverFile | None = None) -> None:
        self._driver = driver or DriverFile()
        self._target = _target_of(address)
        self._messages = wire()
        self.cameras = tuple(self._driver.cameras)
        self._channel: Any = None
        self._calls: dict[str, Any] = {}
        self._session = ""

    def reset(self, spec: ObservationSpec) -> None:
        """Open a session.

        Raises:
            UsageError: the driver does not answer, or refuses.
        """
        import grpc

        self.close()
        messages = self._messages
        self._spec = spec
        self._yaw_rate_radps: float | None = None
        self._channel = grpc.insecure_channel(
            self._target,
            options=[
                ("grpc.max_send_message_length", _MAX_SENT),
                ("grpc.max_receive_message_length", _MAX_RECEIVED),
                ("grpc.enable_http_proxy", 0),
            ],
        )
        self._calls = {
            name: self._channel.unary_unary(
                f"/{DRIVER_SERVICE}/{name}",
                request_serializer=lambda message: message.SerializeToString(),
                response_deserializer=getattr(messages, answer).FromString,
            )
            for name, answer in DRIVER_CALLS.items()
        }
        vehicle = messages.DriveSessionRequest.RolloutSpec.VehicleDefinition(
            available_cameras=[self._available(name, wired) for name, wired in self._driver.cameras.items()]
        )
        session = uuid.uuid4().hex
        request = messages.DriveSessionRequest(
            session_uuid=session,
            random_seed=spec.seed,
            rollout_spec=messages.DriveSessionRequest.RolloutSpec(vehicle=vehicle),
        )
        self._call("start_session", request, self._driver.deadline_s)
        self._session = session

    def act(self, observation: Observation) -> Action:
        """Send the observation and return the driver's trajectory.

        Raises:
            UsageError: the driver does not answer in time, answers with an error or with no valid trajectory, or ends
                the session.
        """
        messages, driver, spec = self._messages, self._driver, self._spec
        until = time.monotonic() + driver.deadline_s
        now_us = to_us(observation.stamp_ns)
        calls: list[tuple[str, Any]] = []

        def send(name: str, request: Any) -> None:
            calls.append((name, self._begin(name, request, until - time.monotonic())))

        send("submit_egomotion_observation", self._egomotion(observation, now_us))
        send("submit_route", self._route(observation.route, now_us))
        for name, wired in driver.cameras.items():
            readout = spec.cameras[name].readout
            first_ns, last_ns = (0.0, 0.0) if readout is None else (readout.first_ns, readout.last_ns)
            image = messages.RolloutCameraImage.CameraImage(
                frame_start_us=now_us + round(1e-3 * first_ns),
                frame_end_us=now_us + round(1e-3 * last_ns),
                image_bytes=encode(observation.images[name], driver.image_format, driver.quality),
                logical_id=wired,
            )
            send(
                "submit_image_observation", messages.RolloutCameraImage(session_uuid=self._session, camera_image=image)
            )
        self._wait(calls)
        request = messages.DriveRequest(
            session_uuid=self._session, time_now_us=now_us, time_query_us=now_us + round(1e6 * spec.step_s)
        )
        answer = self._call("drive", request, until - time.monotonic())
        if answer.terminate_session:
            raise UsageError(
                "the driver ended the session",
                place="drive",
                remedy="the output of the driver says why it ended: start it again",
            )
        return self._plan(answer.trajectory.poses, observation.odometry, now_us)

    def close(self) -> None:
        """Close the session and the connection; a driver that does not answer is not waited for."""
        import grpc

        if self._channel is None:
            return
        if self._session:
            request = self._messages.DriveSessionCloseRequest(session_uuid=self._session)
            with suppress(grpc.RpcError):
                self._calls["close_session"](request, timeout=_CLOSE_S)
        self._channel.close()
        self._channel, self._session = None, ""

    def _available(self, name: str, wired: str) -> Any:
        camera = self._spec.cameras[name]
        return self._messages.AvailableCamerasReturn.AvailableCamera(
            intrinsics=to_spec(
                camera.camera,
                wired,
                self._driver.lens,
                direction="global" if camera.readout is None else camera.readout.direction,
            ),
            rig_to_camera=to_pose(camera.ego_SE3_camera),
            logical_id=wired,
        )

    def _egomotion(self, observation: Observation, now_us: int) -> Any:
        messages, ego = self._messages, observation.ego
        turn = ego.speed_mps * curvature_of(self._spec.vehicle, ego)
        before = turn if self._yaw_rate_radps is None else self._yaw_rate_radps
        self._yaw_rate_radps = turn
        state = messages.DynamicState(
            angular_velocity=vector(0.0, 0.0, turn),
            linear_velocity=vector(ego.speed_mps, 0.0, 0.0),
            linear_acceleration=vector(ego.acceleration_mps2, turn * ego.speed_mps, 0.0),
            angular_acceleration=vector(0.0, 0.0, (turn - before) / self._spec.step_s),
        )
        pose = messages.PoseAtTime(pose=to_flat_pose(*observation.odometry.tolist()), timestamp_us=now_us)
        return messages.RolloutEgoTrajectory(
            session_uuid=self._session, trajectory=messages.Trajectory(poses=[pose]), dynamic_states=[state]
        )

    def _route(self, route: Float64, now_us: int) -> Any:
        """Every second point of the route; behind its end, NaN: AlpaSim's drivers expect a fixed number of points."""
        messages = self._messages
        points = route[::_EVERY].copy()
        short = np.flatnonzero(np.hypot(*np.diff(points, axis=0).T) < _LEAST_STEP_M)
        if len(short):
            points[short[0] + 1 :] = np.nan
        waypoints = [vector(x, y, 0.0 if math.isfinite(x) else math.nan) for x, y in points.tolist()]
        return messages.RouteRequest(
            session_uuid=self._session, route=messages.Route(waypoints=waypoints, timestamp_us=now_us)
        )

    def _plan(self, poses: Sequence[Any], odometry: Float64, now_us: int) -> Action:
        if not poses:
            return NoPlanYet()
        place = "drive"
        if len(poses) > self._driver.max_poses:
            raise UsageError(f"{len(poses)} poses", place=place, expected=f"at most {self._driver.max_poses}")
        stamps = np.array([pose.timestamp_us for pose in poses], np.int64)
        ahead = stamps > now_us
        if not ahead.any() or (np.diff(stamps) <= 0).any():
            raise UsageError(
                f"stamps from {stamps[0] - now_us} to {stamps[-1] - now_us} us after the observation", place=place,
                expected="increasing stamps, some of them later than the observation",
            )  # fmt: skip
        there = flat([pose.pose for pose in poses], [f"{place}, pose {number}" for number in range(len(poses))])[ahead]
        cos, sin = math.cos(odometry[2]), math.sin(odometry[2])
        dx, dy = there[:, 0] - odometry[0], there[:, 1] - odometry[1]
        yaw = np.unwrap(np.concatenate([[0.0], np.remainder(there[:, 2] - odometry[2], 2.0 * np.pi)]))[1:]
        local = np.column_stack([cos * dx + sin * dy, cos * dy - sin * dx, yaw])
        return PlannedTrajectory(1e-6 * (stamps[ahead] - now_us).astype(np.float64), local)

    def _begin(self, name: str, request: Any, timeout_s: float) -> Any:
        return self._calls[name].future(request, timeout=max(timeout_s, 1e-3))

    def _call(self, name: str, request: Any, timeout_s: float) -> Any:
        import grpc

        try:
            return self._calls[name](request, timeout=max(timeout_s, 1e-3))
        except grpc.RpcError as error:
            raise self._failure(name, error) from error

    def _wait(self, calls: Sequence[tuple[str, Any]]) -> None:
        """Wait until calls are acknowledged."""
        import grpc

        for name, call in calls:
            try:
                call.result()
            except grpc.RpcError as error:
                for _, other in calls:
                    other.cancel()
                raise self._failure(name, error) from error

    def _failure(self, name: str, error: Any) -> UsageError:
        import grpc

        code, details = error.code(), " ".join(str(error.details()).split())[:200]
        if code == grpc.StatusCode.DEADLINE_EXCEEDED:
            return LateError(
                f"no answer within {self._driver.deadline_s:g} s", place=name,
                expected=f"an answer of {self._target}", remedy="allow the driver more time: --deadline",
            )  # fmt: skip
        if code == grpc.StatusCode.UNAVAILABLE:
            return UsageError(f"{self._target} does not answer: {details}", place=name, expected="a running driver")
        return UsageError(f"{code.name}: {details}", place=name, expected=f"the service {DRIVER_SERVICE}")


def require_driver(address: str) -> None:
    """Require that a driver accepts connections; call it before a street is opened, which may take minutes.

    Raises:
        UsageError: the address is none, or nobody accepts a connection.
    """
    host, _, port = _target_of(address).rpartition(":")
    require_answer(host, int(port), place="--policy", timeout_s=_CONNECTION_S)


def _target_of(address: str) -> str:
    """HOST:PORT of an address; that of a socket is one."""
    if address.startswith(SOCKET):
        return address
    target = address.removeprefix(SCHEME)
    host, colon, port = target.rpartition(":")
    is_port = port.isascii() and port.isdigit() and 0 < int(port) <= LAST_PORT
    if not (address.startswith(SCHEME) and host and colon and is_port):
        raise UsageError(f"the address is {address!r}", place="--policy", expected=f"{SCHEME}HOST:PORT")
    return target
