"""A policy whose program runs apart, and is asked over a socket. Nothing of it is imported or unpickled here."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Final

from hybridworldsim.simulator.isolation.limits import DRIVE_VARIABLE, PolicyLimits
from hybridworldsim.simulator.isolation.program import IsolatedProgram
from hybridworldsim.simulator.policies.protocol import Action, Observation, ObservationSpec
from hybridworldsim.simulator.remote.driver_file import DriverFile
from hybridworldsim.simulator.remote.policy import RemotePolicy
from mirror.errors import UsageError

_LOOK_S: Final = 0.02

Start = Callable[[Mapping[str, str]], IsolatedProgram]


class IsolatedPolicy:
    """A policy that starts a program for each drive, and ends it with the drive.

    Args:
        start: starts the program, with the given environment variables.
        cameras: the cameras that it gets.
        deadline_s: longest time for an action.
        limits: bounds of the program.
    """

    privileged = False

    def __init__(self, start: Start, cameras: Sequence[str], deadline_s: float, limits: PolicyLimits) -> None:
        self.cameras = tuple(cameras)
        self._start, self._limits = start, limits
        self._driver = DriverFile(
            cameras={camera: camera for camera in cameras}, image_format="png", deadline_s=deadline_s
        )
        self._program: IsolatedProgram | None = None
        self._remote: RemotePolicy | None = None

    def reset(self, spec: ObservationSpec) -> None:
        """Start the program, wait until it serves, and open a session.

        Raises:
            UsageError: the program ends, or does not serve in time.
        """
        self.close()
        facts = {"step_s": spec.step_s, "vehicle": asdict(spec.vehicle)}
        program = self._program = self._start({DRIVE_VARIABLE: json.dumps(facts)})
        until = time.monotonic() + self._limits.start_s
        while (socket := program.find_socket()) is None:
            if not program.is_running:
                raise UsageError(program.describe_end(), place="start", expected="a program that serves the driver")
            if time.monotonic() > until:
                raise UsageError(
                    f"nothing serves at its socket after {self._limits.start_s:g} s", place="start",
                    expected="a driver at the path in MIRROR_POLICY_SOCKET",
                )  # fmt: skip
            time.sleep(_LOOK_S)
        self._remote = RemotePolicy(f"unix:{socket}", self._driver)
        self._ask(lambda remote: remote.reset(spec))

    def act(self, observation: Observation) -> Action:
        """Return the program's action.

        Raises:
            UsageError: the program has ended, or its answer is none.
            LateError: it did not answer in time.
        """
        return self._ask(lambda remote: remote.act(observation))

    def close(self) -> None:
        """End the program."""
        remote, program, self._remote, self._program = self._remote, self._program, None, None
        try:
            if remote is not None:
                remote.close()
        finally:
            if program is not None:
                program.kill()

    def _ask(self, call: Callable[[RemotePolicy], Action]) -> Action:
        program, remote = self._program, self._remote
        if program is None or remote is None:
            raise UsageError("no drive has begun", expected="a reset before an action")
        try:
            return call(remote)
        except UsageError as error:
            # A program that ends breaks the connection a little before it is known to have ended.
            time.sleep(_LOOK_S)
            if program.fault is None and program.is_running:
                raise
            raise UsageError(program.describe_end(), place=error.place, expected="a program that runs") from error
