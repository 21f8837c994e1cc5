"""Policies in a sandbox: what they can reach, and what ends them. Containers are skipped where no engine answers."""

from __future__ import annotations

import shlex
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hybridworldsim.simulator.ego.vehicle import Controls, EgoState
from hybridworldsim.simulator.isolation import container, sandbox
from hybridworldsim.simulator.isolation.choice import PolicyChoice
from hybridworldsim.simulator.isolation.isolated_policy import IsolatedPolicy
from hybridworldsim.simulator.isolation.limits import PolicyLimits
from hybridworldsim.simulator.isolation.program import IsolatedProgram
from hybridworldsim.simulator.isolation.sandbox import start_in_sandbox
from hybridworldsim.simulator.isolation.serve import follow
from hybridworldsim.simulator.renderers.protocol import rig_cameras
from hybridworldsim.simulator.rollout.run import RolloutResult, run_rollout
from mirror.errors import UsageError
from mirror.metrics.safety import read_state_log
from mirror.schema.rollout import STATES_FILE
from tests.simulator.requests import STREET, request
from tests.simulator.streets import scenario

needs_bubblewrap = pytest.mark.skipif(shutil.which("bwrap") is None, reason="bubblewrap is not installed")
needs_engine = pytest.mark.skipif(container.find_engine() is None, reason="neither podman nor docker answers")
LIMITS = PolicyLimits(memory_bytes=512 << 20, processes=40, disk_bytes=8 << 20, start_s=20.0)
POLICY = """
import numpy as np
from hybridworldsim.simulator import Controls

class Faster:
    cameras, privileged = ("rear",), False

    def reset(self, spec):
        self.spec = spec

    def act(self, observation):
        assert observation.images["rear"].shape == (27, 48, 3) and observation.images["rear"].dtype == np.uint8
        assert abs(self.spec.step_s - 0.1) < 1e-9 and self.spec.vehicle.length_m > 0.0
        assert self.spec.cameras["rear"].camera.width_px == 48
        return Controls(1.0, 0.0)

    def close(self):
        pass
"""


def run(code: str, folder: Path | None = None, limits: PolicyLimits = LIMITS, wait_s: float = 20.0) -> str:
    """Run Python in a sandbox to its end, and return why it ended with what it wrote to its error output."""
    program = start_in_sandbox(_python(code), folder, limits, {})
    until = time.monotonic() + wait_s
    while program.is_running and time.monotonic() < until:
        time.sleep(0.02)
    time.sleep(0.2)
    said = "is running" if program.is_running else program.describe_end()
    program.kill()
    return said


def _python(code: str) -> str:
    return shlex.join([sys.executable, "-S", "-c", code])


def drive(command: str, folder: Path | None, out: Path, deadline_s: float = 20.0) -> RolloutResult:
    started: list[IsolatedProgram] = []

    def start(variables: dict[str, str]) -> IsolatedProgram:
        started.append(start_in_sandbox(command, folder, PolicyLimits(start_s=60.0), variables))
        return started[-1]

    policy = IsolatedPolicy(start, ("rear",), deadline_s, PolicyLimits(start_s=60.0))
    result = run_rollout(
        request(policy, cameras=rig_cameras(STREET, tuple(STREET.rig), 48), scenario=scenario(duration_s=1.0)), out
    )
    assert started and not started[-1].is_running
    return result


@needs_bubblewrap
def test_a_policy_of_a_file_drives_in_a_sandbox_as_it_drives_here(tmp_path: Path) -> None:
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "drive.py").write_text(POLICY)
    choice = PolicyChoice.parse(f"sandbox:{tmp_path / 'files' / 'drive.py'}:Faster")
    assert choice.isolation == "sandbox" and choice.folder == tmp_path / "files"
    result = drive(choice.command, choice.folder, tmp_path / "run")
    assert result.error is None
    log = read_state_log(tmp_path / "run" / STATES_FILE)
    # Constant acceleration from the start, which the tracker follows within its own lag.
    assert log.vx_mps[-1, 0] - log.vx_mps[0, 0] == pytest.approx(1.0, abs=0.1)


@needs_bubblewrap
def test_a_policy_sees_its_own_files_and_no_others(tmp_path: Path) -> None:
    own = tmp_path / "files"
    own.mkdir()
    (own / "weights.txt").write_text("mine")
    secret = tmp_path / "secret.txt"
    secret.write_text("0123456789abcdef0123456789abcdef")
    places = [str(secret), str(tmp_path), "/etc/passwd", "/etc/shadow", "/home", "/var", "/proc/1/root/etc/passwd"]
    places += [str(Path(__file__).parents[2] / "README.md"), str(Path(__file__).parents[2] / "tests")]
    code = f"""
import os, sys
assert open("/policy/weights.txt").read() == "mine"
for place in {places!r}:
    try:
        found = os.listdir(place) if os.path.isdir(place) else open(place).read()
    except OSError:
        continue
    sys.exit("read " + place + ": " + str(found)[:80])
processes = [name for name in os.listdir("/proc") if name.isdigit()]
assert len(processes) < 6, processes
assert "0123456789abcdef" not in str(os.environ)
for place in ("/policy/new", "/new", "/usr/new", "/dev/new", {str(own / "new")!r}):
    try:
        open(place, "w")
    except OSError:
        continue
    sys.exit("wrote " + place)
sys.exit("nothing")
"""
    assert run(code, own).endswith("nothing")
    assert sorted(path.name for path in own.iterdir()) == ["weights.txt"]


@needs_bubblewrap
def test_a_policy_has_no_network(tmp_path: Path) -> None:
    import socket

    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        code = f"""
import socket, sys
try:
    socket.create_connection(("127.0.0.1", {port}), timeout=2)
except OSError as error:
    sys.exit("refused " + type(error).__name__)
"""
        assert "refused" in run(code)


@needs_bubblewrap
def test_a_fork_bomb_is_bounded_and_ends_with_the_drive() -> None:
    code = """
import os, sys, time
count = 0
while True:
    try:
        if os.fork() == 0:
            time.sleep(60)
            os._exit(0)
        count += 1
    except OSError:
        sys.exit(f"stopped after {count}")
"""
    said = run(code)
    assert "stopped after" in said or "processes and threads" in said
    if "stopped after" in said:
        assert int(said.split()[-1]) <= LIMITS.processes
    # A bomb that goes on: every process forks again, and none ends by itself.
    program = start_in_sandbox(
        _python("import os\nwhile True:\n    try:\n        os.fork()\n    except OSError:\n        pass"),
        None,
        LIMITS,
        {},
    )
    time.sleep(1.0)
    program.kill()
    assert not program.is_running


@needs_bubblewrap
def test_memory_and_disk_are_bounded() -> None:
    assert run("data = bytearray(4 << 30)\nimport time; time.sleep(60)") != "is running"
    shared = "import os\nparts = []\nfor n in range(8):\n    if os.fork() == 0:\n        break\n"
    said = run(shared + "part = bytearray(b'1') * (200 << 20)\nimport time; time.sleep(60)")
    assert "MiB of memory" in said
    code = """
import sys
written = 0
try:
    for number in range(1000):
        with open(f"/tmp/{number}", "wb") as file:
            file.write(bytes(1 << 20))
        written += 1
except OSError as error:
    sys.exit(f"full after {written}: {error.strerror}")
"""
    assert run(code).endswith("full after 8: No space left on device")


@needs_bubblewrap
def test_a_silent_one_and_one_that_ends_are_named(tmp_path: Path) -> None:
    silent = PolicyChoice.parse("sandbox:sleep 60")
    policy = IsolatedPolicy(
        lambda variables: start_in_sandbox(silent.command, None, LIMITS, variables),
        ("rear",),
        1.0,
        PolicyLimits(start_s=0.5),
    )
    cameras = rig_cameras(STREET, tuple(STREET.rig), 48)
    begun = time.monotonic()
    result = run_rollout(request(policy, cameras=cameras, scenario=scenario(duration_s=1.0)), tmp_path / "silent")
    assert result.rollout.ending == "policy" and "nothing serves" in str(result.rollout.reason)
    assert time.monotonic() - begun < 15.0
    result = drive(_python("import sys; sys.exit('lost my way')"), None, tmp_path / "ended")
    assert result.rollout.ending == "policy" and "lost my way" in str(result.rollout.reason)


@needs_bubblewrap
def test_one_that_serves_and_then_is_silent_ends_the_drive_at_its_deadline(tmp_path: Path) -> None:
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "slow.py").write_text(
        POLICY.replace("return Controls(1.0, 0.0)", "import time; time.sleep(60)")
    )
    choice = PolicyChoice.parse(f"sandbox:{tmp_path / 'files' / 'slow.py'}:Faster")
    result = drive(choice.command, choice.folder, tmp_path / "run", deadline_s=1.5)
    assert result.rollout.ending == "deadline" and result.rollout.steps == 0


@needs_bubblewrap
def test_a_link_at_the_place_of_the_socket_is_not_followed(tmp_path: Path) -> None:
    import socket

    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "own.sock"))
        code = f"import os, time\nos.symlink({str(tmp_path / 'own.sock')!r}, '/tmp/policy.sock')\ntime.sleep(60)"
        program = start_in_sandbox(_python(code), None, LIMITS, {})
        time.sleep(1.5)
        found = program.find_socket()
        program.kill()
    assert found is None


@needs_engine
def test_a_silent_container_is_named(tmp_path: Path) -> None:
    """No image is shipped: that an engine refuses an unknown one by name is all that every machine can show."""
    with pytest.raises(UsageError, match="no image"):
        container.require_image("mirror-policy-that-nobody-built")


def test_the_command_of_a_container_has_no_network_and_is_bounded() -> None:
    words = container.build_command("podman", "image:1", "name", PolicyLimits(), {"MIRROR_DRIVE": "{}"})
    text = " ".join(words)
    for part in (
        "--network none",
        "--read-only",
        "--cap-drop ALL",
        "--security-opt no-new-privileges",
        "--pids-limit 256",
        f"--memory {4 << 30}",
        "--pull never",
        "--user 65534:65534",
    ):
        assert part in text
    assert words[-1] == "image:1" and "MIRROR_DRIVE={}" in words


@pytest.mark.parametrize(
    ("name", "require", "installs"),
    [
        ("bwrap", sandbox.require_bubblewrap, "apt-get install bubblewrap"),
        ("podman", container.require_engine, "apt-get install podman"),
    ],
)
def test_without_the_program_the_policy_is_refused_with_what_to_install(
    name: str, require: Callable[[], str], installs: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    container.find_engine.cache_clear()
    with pytest.raises(UsageError, match=installs):
        require()
    container.find_engine.cache_clear()


@pytest.mark.parametrize(
    ("text", "message"),
    [("sandbox:", "sandbox:COMMAND"), ("container", "container:IMAGE"), ("sandbox:missing.py:Policy", "no such file")],
)
def test_a_policy_that_names_nothing_is_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        PolicyChoice.parse(text)


def test_controls_become_the_arc_that_they_describe() -> None:
    ego = EgoState(0.0, 0.0, 0.0, 4.0)
    plan = follow(Controls(-2.0, 0.1), ego)
    # Small steps of the same motion: speed 4 - 2 t to standstill at 2 s.
    x = y = yaw = 0.0
    for step in range(20000):
        speed = max(4.0 - 2.0 * (step + 0.5) * 1e-4, 0.0)
        yaw += 0.5 * 0.1 * speed * 1e-4
        x, y = x + np.cos(yaw) * speed * 1e-4, y + np.sin(yaw) * speed * 1e-4
        yaw += 0.5 * 0.1 * speed * 1e-4
    np.testing.assert_allclose(plan.poses[-1], (x, y, yaw), atol=1e-6)
    assert plan.times_s[-1] == pytest.approx(2.0)
