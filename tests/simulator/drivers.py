"""A driver that serves AlpaSim's interface, for tests: it keeps what it gets, and answers by a function."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import grpc

from hybridworldsim.simulator.remote.messages import DRIVER_SERVICE, wire

REQUESTS = {
    "start_session": "DriveSessionRequest",
    "close_session": "DriveSessionCloseRequest",
    "submit_image_observation": "RolloutCameraImage",
    "submit_egomotion_observation": "RolloutEgoTrajectory",
    "submit_route": "RouteRequest",
    "drive": "DriveRequest",
}


class Driver:
    """Keeps the calls in the order in which they end; ``answer(number, self)`` gives the response of a drive."""

    def __init__(self, answer: Callable, before: Callable[[str], None] = lambda name: None) -> None:
        self.answer, self.before, self.calls, self.lock = answer, before, [], threading.Lock()
        self.address = ""

    def got(self, name: str) -> list:
        return [request for called, request in self.calls if called == name]

    def handle(self, name: str, request: object, context: grpc.ServicerContext) -> object:
        self.before(name)
        with self.lock:
            self.calls.append((name, request))
        messages = wire()
        if name == "drive":
            return self.answer(len(self.got("drive")) - 1, self, context)
        return messages.SessionRequestStatus() if name == "start_session" else messages.Empty()


@contextmanager
def serving(driver: Driver) -> Iterator[Driver]:
    messages = wire()

    def handler(name: str) -> grpc.RpcMethodHandler:
        return grpc.unary_unary_rpc_method_handler(
            lambda request, context: driver.handle(name, request, context),
            getattr(messages, REQUESTS[name]).FromString,
            lambda message: message.SerializeToString(),
        )

    server = grpc.server(ThreadPoolExecutor(8))
    server.add_generic_rpc_handlers(
        (grpc.method_handlers_generic_handler(DRIVER_SERVICE, {name: handler(name) for name in REQUESTS}),)
    )
    driver.address = f"grpc://127.0.0.1:{server.add_insecure_port('127.0.0.1:0')}"
    server.start()
    try:
        yield driver
    finally:
        server.stop(0)


def straight_on(speed_mps: float, horizon_s: float = 4.0) -> Callable:
    """Answer with a straight line at a speed, from the last pose that the driver got; its first pose is the present."""

    def answer(number: int, driver: Driver, context: object) -> object:
        messages = wire()
        response = messages.DriveResponse()
        pose = driver.got("submit_egomotion_observation")[-1].trajectory.poses[-1]
        for step in range(int(10.0 * horizon_s) + 1):
            added = response.trajectory.poses.add()
            added.CopyFrom(pose)
            added.timestamp_us = pose.timestamp_us + 100_000 * step
            added.pose.vec.x += 0.1 * step * speed_mps
        return response

    return answer
