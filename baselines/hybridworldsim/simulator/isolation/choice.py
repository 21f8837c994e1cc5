"""The policy of a suite as a user types it: an installed one, a file, a sandbox or a container."""

from __future__ import annotations

import math
import shlex
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from hybridworldsim.simulator.isolation.container import require_engine, require_image, start_in_container
from hybridworldsim.simulator.isolation.isolated_policy import IsolatedPolicy
from hybridworldsim.simulator.isolation.limits import PolicyLimits
from hybridworldsim.simulator.isolation.sandbox import require_bubblewrap, start_in_sandbox
from hybridworldsim.simulator.policies.protocol import Policy
from hybridworldsim.simulator.policy_registry import make_policy
from mirror.errors import UsageError
from mirror.plugins import is_file_reference
from mirror.protocols.suite import Suite
from mirror.schema.suite_run import Isolation

_SERVE: Final = "hybridworldsim.simulator.isolation.serve"


@dataclass(frozen=True)
class PolicyChoice:
    """A policy, and how it is kept apart from this machine.

    Attributes:
        name: the policy as it was named.
        isolation: how it is kept apart; None: it runs in the simulator's own process.
        command: command of a sandbox, or image of a container; empty: neither.
        folder: folder that a sandbox shows to the program; None: none.
        limits: bounds of the program.
    """

    name: str
    isolation: Isolation | None = None
    command: str = ""
    folder: Path | None = None
    limits: PolicyLimits = field(default_factory=PolicyLimits)

    @classmethod
    def parse(cls, text: str, folder: Path | None = None) -> PolicyChoice:
        """Parse ``NAME``, ``FILE.py:CLASS``, ``sandbox:FILE.py:CLASS``, ``sandbox:COMMAND`` or ``container:IMAGE``.

        Args:
            text: the text.
            folder: folder for the program of a sandbox; None: that of its file, or none.

        Raises:
            UsageError: nothing follows the word, the folder is none, or belongs to no sandbox.
        """
        kind, colon, rest = text.partition(":")
        isolation: Isolation | None = "sandbox" if kind == "sandbox" else "container" if kind == "container" else None
        if folder is not None and isolation != "sandbox":
            raise UsageError("a folder for no sandbox", place="--policy-folder", expected="--policy sandbox:COMMAND")
        if folder is not None and not folder.is_dir():
            raise UsageError("no such folder", file=folder, place="--policy-folder")
        if isolation is None:
            return cls(text)
        if not colon or not rest.strip():
            raise UsageError(f"{text!r}", place="--policy", expected="sandbox:COMMAND or container:IMAGE")
        if isolation == "sandbox" and is_file_reference(rest):
            file, _, name = rest.rpartition(":")
            path = Path(file)
            if not path.is_file():
                raise UsageError("no such file", file=path, place="--policy", expected="sandbox:FILE.py:CLASS")
            folder = folder or path.resolve().parent
            if not path.resolve().is_relative_to(folder.resolve()):
                raise UsageError("the file lies elsewhere", file=path, place="--policy-folder", expected="its folder")
            inside = path.resolve().relative_to(folder.resolve())
            rest = shlex.join([sys.executable, "-m", _SERVE, f"{inside}:{name}"])
        return cls(text, isolation, rest, folder)

    def require_available(self) -> None:
        """Require the program that keeps the policy apart.

        Raises:
            UsageError: it is not installed, or the image is not there; the message says what to install.
        """
        if self.isolation == "sandbox":
            require_bubblewrap()
        elif self.isolation == "container":
            require_engine()
            require_image(self.command)

    def make(self, suite: Suite) -> Policy:
        """Make the policy for a drive of a suite.

        Raises:
            UsageError: there is no such policy.
        """
        if self.isolation is None:
            return make_policy(self.name)
        command, folder, limits = self.command, self.folder, self.limits
        if self.isolation == "sandbox":
            return IsolatedPolicy(
                lambda variables: start_in_sandbox(command, folder, limits, variables),
                suite.cameras, suite.deadline_s, limits,
            )  # fmt: skip
        return IsolatedPolicy(
            lambda variables: start_in_container(command, limits, variables), suite.cameras, suite.deadline_s, limits
        )

    def deadline_s(self, suite: Suite) -> float:
        """Return the deadline that the simulator watches; a policy that runs apart is watched at its socket."""
        return suite.deadline_s if self.isolation is None else math.inf
