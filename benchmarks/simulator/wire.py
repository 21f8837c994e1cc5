"""Time that a policy behind gRPC adds to a step: encoding, messages, acknowledgements, and the answer."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

import numpy as np

from benchmarks.report import Row
from hybridworldsim.simulator.ego.vehicle import EgoState, VehicleParameters
from hybridworldsim.simulator.policies.protocol import Observation, ObservationSpec
from hybridworldsim.simulator.remote.driver_file import DriverFile
from hybridworldsim.simulator.remote.messages import DRIVER_SERVICE, wire
from hybridworldsim.simulator.remote.policy import RemotePolicy
from hybridworldsim.simulator.renderers.protocol import rig_cameras
from hybridworldsim.simulator.street.street import Street
from mirror.arrays import UInt8

_STEPS = 60
_WARM = 10
_BARS_MS = {1: 3.0, 7: 15.0}


def measure_wire(street: Street) -> Iterator[Row]:
    """Measure steps with one and with seven cameras of 240 x 135, against a driver in another process."""
    cameras = rig_cameras(street, tuple(street.rig), 240, 135)
    images = {name: _photograph(number) for number, name in enumerate(cameras)}
    with _driver() as address:
        for count in _BARS_MS:
            names = tuple(cameras)[:count]
            policy = RemotePolicy(address, DriverFile(cameras={name: name for name in names}))
            policy.reset(ObservationSpec({name: cameras[name] for name in names}, VehicleParameters(), 0.1))
            times, cores = [], []
            for step in range(_WARM + _STEPS):
                observation = Observation(
                    10**18 + step * 10**8, images, EgoState(0.0, 0.0, 0.0, 10.0), np.zeros((40, 2)), np.zeros(3)
                )
                begin, core = time.perf_counter(), time.process_time()
                policy.act(observation)
                times.append(time.perf_counter() - begin)
                cores.append(time.process_time() - core)
            policy.close()
            size = f"{count} JPEG of 240x135"
            yield Row("policy behind gRPC (wall)", size, 1e3 * float(np.median(times[_WARM:])), bar=_BARS_MS[count])
            yield Row("policy behind gRPC (core time, without the driver)", size, 1e3 * float(np.median(cores[_WARM:])))


def _photograph(seed: int) -> UInt8:
    """An image whose JPEG is about as long as that of a street."""
    rows, columns = np.mgrid[:135, :240]
    smooth = 110.0 + 60.0 * np.sin(0.07 * columns + seed) * np.cos(0.05 * rows)
    noise = np.random.default_rng(seed).normal(0.0, 6.0, (135, 240, 3))
    return np.clip(smooth[..., None] + noise, 0, 255).astype(np.uint8)


@contextmanager
def _driver() -> Iterator[str]:
    context = get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_serve, args=(sender,), daemon=True)
    process.start()
    try:
        yield f"grpc://127.0.0.1:{receiver.recv()}"
    finally:
        process.terminate()
        process.join()


def _serve(sender: Any) -> None:
    """A driver that acknowledges all it gets, and answers with a trajectory of 4 s."""
    import grpc

    messages = wire()
    identity = messages.Pose(quat=messages.Quat(w=1.0))

    def drive(request: Any, context: Any) -> Any:
        now = request.time_now_us
        poses = [messages.PoseAtTime(pose=identity, timestamp_us=now + 100_000 * step) for step in range(41)]
        return messages.DriveResponse(trajectory=messages.Trajectory(poses=poses))

    def handler(message: str, answer: Any) -> Any:
        kind = getattr(messages, message)
        return grpc.unary_unary_rpc_method_handler(answer, kind.FromString, lambda reply: reply.SerializeToString())

    def acknowledge(request: Any, context: Any) -> Any:
        return messages.Empty()

    handlers = {
        "start_session": handler("DriveSessionRequest", acknowledge),
        "close_session": handler("DriveSessionCloseRequest", acknowledge),
        "submit_image_observation": handler("RolloutCameraImage", acknowledge),
        "submit_egomotion_observation": handler("RolloutEgoTrajectory", acknowledge),
        "submit_route": handler("RouteRequest", acknowledge),
        "drive": handler("DriveRequest", drive),
    }
    server = grpc.server(ThreadPoolExecutor(8))
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(DRIVER_SERVICE, handlers),))
    sender.send(server.add_insecure_port("127.0.0.1:0"))
    server.start()
    server.wait_for_termination()
