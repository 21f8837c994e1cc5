"""Serves a policy of a Python file as a driver at the socket of its sandbox or container.

``python -m hybridworldsim.simulator.isolation.serve FILE.py:CLASS``. A driver answers with trajectories: controls
become the path of constant acceleration and curvature of the next seconds.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Final

import cv2
import numpy as np

from hybridworldsim.simulator.ego.vehicle import Controls, EgoState, VehicleParameters
from hybridworldsim.simulator.isolation.limits import DRIVE_VARIABLE, SOCKET_VARIABLE
from hybridworldsim.simulator.policies.protocol import (
    Action,
    CameraSpec,
    NoPlanYet,
    Observation,
    ObservationSpec,
    PlannedTrajectory,
    Policy,
    image_form,
)
from hybridworldsim.simulator.policy_registry import make_policy
from hybridworldsim.simulator.remote.lenses import from_spec
from hybridworldsim.simulator.remote.messages import DRIVER_SERVICE, wire
from hybridworldsim.simulator.remote.poses import from_pose, to_flat_pose
from mirror.arrays import UInt8
from mirror.errors import MirrorError, UsageError
from mirror.schema.strict_json import decode_json

_AHEAD_S: Final = 2.0
_STEP_S: Final = 0.1
_REQUESTS: Final = {
    "start_session": "DriveSessionRequest",
    "close_session": "DriveSessionCloseRequest",
    "submit_image_observation": "RolloutCameraImage",
    "submit_egomotion_observation": "RolloutEgoTrajectory",
    "submit_route": "RouteRequest",
    "drive": "DriveRequest",
}


class PolicyService:
    """The calls of a driver, answered by a policy.

    Args:
        policy: the policy.
        step_s: time between observations.
        vehicle: the ego vehicle.

    Raises:
        UsageError: the policy reads the exact state, which is not sent.
    """

    def __init__(self, policy: Policy, step_s: float, vehicle: VehicleParameters) -> None:
        if policy.privileged:
            raise UsageError("the policy reads the exact state", place="privileged", expected="False")
        self._policy, self._step_s, self._vehicle = policy, step_s, vehicle
        self._in_tensors = image_form(policy, type(policy).__name__) == "torch"
        self._images: dict[str, UInt8] = {}
        self._motion: Any = None
        self._route: Any = None

    def start_session(self, request: Any) -> Any:
        """Prepare the policy."""
        cameras = {}
        for one in request.rollout_spec.vehicle.available_cameras:
            cameras[one.logical_id] = CameraSpec(
                from_spec(one.intrinsics), from_pose(one.rig_to_camera, f"camera {one.logical_id!r}")
            )
        unknown = [name for name in self._policy.cameras if name not in cameras]
        if unknown:
            raise UsageError(f"no camera {unknown[0]!r}", place="cameras", expected=f"some of {', '.join(cameras)}")
        chosen = {name: cameras[name] for name in self._policy.cameras}
        self._policy.reset(ObservationSpec(chosen, self._vehicle, self._step_s, request.random_seed))
        return wire().SessionRequestStatus()

    def close_session(self, request: Any) -> Any:
        """Release the policy."""
        self._policy.close()
        return wire().Empty()

    def submit_image_observation(self, request: Any) -> Any:
        """Keep an image, if the policy reads it."""
        image = request.camera_image
        if image.logical_id in self._policy.cameras:
            data = cv2.imdecode(np.frombuffer(image.image_bytes, np.uint8), cv2.IMREAD_COLOR)
            self._images[image.logical_id] = np.ascontiguousarray(np.asarray(data, np.uint8)[..., ::-1])
        return wire().Empty()

    def submit_egomotion_observation(self, request: Any) -> Any:
        """Keep the motion of the ego."""
        self._motion = request
        return wire().Empty()

    def submit_route(self, request: Any) -> Any:
        """Keep the route."""
        self._route = request.route
        return wire().Empty()

    def drive(self, request: Any) -> Any:
        """Ask the policy."""
        state, pose = self._motion.dynamic_states[-1], self._motion.trajectory.poses[-1].pose
        speed = float(state.linear_velocity.x)
        turn = float(state.angular_velocity.z) / speed if speed > 1e-3 else 0.0
        steering = float(np.arctan(turn * self._vehicle.wheelbase_m))
        ego = EgoState(0.0, 0.0, 0.0, speed, float(state.linear_acceleration.x), steering)
        points = np.array([(point.x, point.y) for point in self._route.waypoints], np.float64).reshape(-1, 2)
        points = points[np.isfinite(points).all(axis=1)]
        yaw = 2.0 * np.arctan2(pose.quat.z, pose.quat.w)
        odometry = np.array([pose.vec.x, pose.vec.y, yaw])
        seen = Observation(1000 * request.time_now_us, dict(self._images), ego, points, odometry)
        if self._in_tensors:
            from hybridworldsim.simulator.renderers.protocol import to_tensors

            seen = replace(seen, images={}, tensors=to_tensors(self._images))
        return self._answer(self._policy.act(seen), ego, odometry, request.time_now_us)

    def _answer(self, action: Action, ego: EgoState, odometry: Any, now_us: int) -> Any:
        response = wire().DriveResponse()
        if isinstance(action, NoPlanYet) or action is None:
            return response
        plan = follow(action, ego) if isinstance(action, Controls) else action
        if not isinstance(plan, PlannedTrajectory):
            raise UsageError(f"an action of type {type(action).__name__}", expected="Controls or PlannedTrajectory")
        cos, sin = np.cos(odometry[2]), np.sin(odometry[2])
        for time_s, (x, y, yaw) in zip(plan.times_s, plan.poses, strict=True):
            added = response.trajectory.poses.add()
            added.timestamp_us = now_us + round(1e6 * float(time_s))
            there = odometry[0] + cos * x - sin * y, odometry[1] + sin * x + cos * y, odometry[2] + yaw
            added.pose.CopyFrom(to_flat_pose(*map(float, there)))
        return response


def follow(controls: Controls, ego: EgoState) -> PlannedTrajectory:
    """Return the path of constant acceleration and curvature of the next two seconds."""
    times = np.arange(_STEP_S, _AHEAD_S + 1e-9, _STEP_S)
    acceleration, curvature = controls.acceleration_mps2, controls.curvature_radpm
    moving = np.minimum(times, -ego.speed_mps / acceleration) if acceleration < 0.0 else times
    along = ego.speed_mps * moving + 0.5 * acceleration * moving**2
    yaw = curvature * along
    bent = np.abs(yaw) > 1e-6
    safe = np.where(bent, yaw, 1.0)
    x = np.where(bent, along * np.sin(safe) / safe, along)
    y = np.where(bent, along * (1.0 - np.cos(safe)) / safe, 0.0)
    return PlannedTrajectory(times, np.column_stack([x, y, yaw]))


def main(name: str) -> None:
    """Serve a policy at the socket until the process is ended.

    Raises:
        UsageError: there is no such policy, or the environment names no socket.
    """
    import grpc

    socket = os.environ.get(SOCKET_VARIABLE)
    if socket is None:
        raise UsageError(f"{SOCKET_VARIABLE} is not set", expected="the path of the socket, which the simulator sets")
    facts = decode_json(os.environ.get(DRIVE_VARIABLE, "{}"))
    vehicle = VehicleParameters(**facts.get("vehicle", {}))
    service = PolicyService(make_policy(name), float(facts.get("step_s", _STEP_S)), vehicle)
    server = grpc.server(ThreadPoolExecutor(4))
    handlers = {call: _handler(getattr(service, call), message) for call, message in _REQUESTS.items()}
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(DRIVER_SERVICE, handlers),))
    server.add_insecure_port(f"unix:{socket}")
    server.start()
    server.wait_for_termination()


def _handler(call: Callable[[Any], Any], message: str) -> Any:
    import grpc

    def answer(request: Any, context: Any) -> Any:
        try:
            return call(request)
        except MirrorError as error:
            context.abort(grpc.StatusCode.INVALID_ARGUMENT, str(error))

    return grpc.unary_unary_rpc_method_handler(
        answer, getattr(wire(), message).FromString, lambda reply: reply.SerializeToString()
    )


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except MirrorError as problem:
        sys.exit(str(problem))
