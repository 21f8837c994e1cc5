"""Programs in a container of podman or docker, bounded as in a sandbox."""

from __future__ import annotations

import shutil
import subprocess
import uuid
from collections.abc import Mapping
from functools import lru_cache
from typing import Final

from hybridworldsim.simulator.isolation.limits import SOCKET, SOCKET_VARIABLE, PolicyLimits
from hybridworldsim.simulator.isolation.program import IsolatedProgram
from mirror.errors import UsageError

_ENGINES: Final = ("podman", "docker")
_ANSWER_S: Final = 20.0
_NOBODY: Final = "65534:65534"


@lru_cache(maxsize=1)
def find_engine() -> str | None:
    """Find the engine that runs containers here, podman before docker; None: none answers."""
    for name in _ENGINES:
        program = shutil.which(name)
        if program is not None and _run(program, "info") is not None:
            return program
    return None


def require_engine() -> str:
    """Return the path of the engine.

    Raises:
        UsageError: none is installed, or none answers.
    """
    engine = find_engine()
    if engine is None:
        raise UsageError(
            "neither podman nor docker answers", place="--policy container:IMAGE", expected="one of the two",
            remedy="install podman: apt-get install podman; or start the service of docker",
        )  # fmt: skip
    return engine


def require_image(image: str) -> None:
    """Require that an image is on this machine: nothing is fetched.

    Raises:
        UsageError: it is not.
    """
    if _run(require_engine(), "image", "inspect", image) is None:
        raise UsageError(
            f"no image {image!r} on this machine", place="--policy", expected="an image that is built or loaded",
            remedy="load it: podman load < IMAGE.tar",
        )  # fmt: skip


def start_in_container(image: str, limits: PolicyLimits, variables: Mapping[str, str]) -> IsolatedProgram:
    """Start the program of an image in a container.

    Args:
        image: name of the image; its own command runs.
        limits: its bounds.
        variables: environment variables, beside that of the socket.

    Raises:
        UsageError: no engine answers.
    """
    engine, name = require_engine(), f"mirror-policy-{uuid.uuid4().hex}"
    found: list[int] = []

    def find_root() -> int | None:
        if not found:
            text = _run(engine, "inspect", "--format", "{{.State.Pid}}", name)
            if text is not None and text.strip().isdigit() and int(text) > 0:
                found.append(int(text))
        return found[0] if found else None

    def end() -> None:
        _run(engine, "rm", "--force", name)

    return IsolatedProgram(build_command(engine, image, name, limits, variables), limits, find_root, end)


def build_command(engine: str, image: str, name: str, limits: PolicyLimits, variables: Mapping[str, str]) -> list[str]:
    """Build the command that runs an image in a container of a name."""
    words = [
        engine, "run", "--rm", "--name", name, "--pull", "never", "--network", "none", "--read-only",
        "--cap-drop", "ALL", "--security-opt", "no-new-privileges", "--user", _NOBODY,
        "--pids-limit", str(limits.processes), "--memory", str(limits.memory_bytes),
        "--memory-swap", str(limits.memory_bytes), "--ulimit", f"fsize={limits.disk_bytes}", "--ulimit", "core=0",
        "--tmpfs", f"/tmp:rw,nosuid,nodev,mode=1777,size={limits.disk_bytes}",
    ]  # fmt: skip
    for key, value in {SOCKET_VARIABLE: SOCKET, **variables}.items():
        words += ["--env", f"{key}={value}"]
    return [*words, image]


def _run(*words: str) -> str | None:
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=_ANSWER_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None
