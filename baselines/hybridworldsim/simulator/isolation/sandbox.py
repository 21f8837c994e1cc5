"""Programs in a sandbox of bubblewrap.

The program sees the system's libraries, this Python with its packages, and the policy's folder, all read-only, and
nothing else of this machine: no home, no data set, no secret. It has no network, no capabilities, and a small file
system in memory for its files.
"""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from collections.abc import Mapping
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from hybridworldsim.simulator.isolation.limits import SOCKET, SOCKET_VARIABLE, PolicyLimits
from hybridworldsim.simulator.isolation.program import IsolatedProgram
from mirror.errors import UsageError
from mirror.schema.strict_json import decode_json

POLICY_FOLDER: Final = "/policy"
_SYSTEM: Final = ("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/etc/ld.so.cache", "/etc/alternatives")
_PACKAGES: Final = ("mirror", "hybridworldsim")
_FIRST_USER: Final = 2_000_000
_SHARED_MEMORY: Final = 64 << 20
_FILES: Final = 1024


def require_bubblewrap() -> str:
    """Return the path of bubblewrap.

    Raises:
        UsageError: it, or a program of util-linux that it needs here, is not installed.
    """
    for program, package in (("bwrap", "bubblewrap"), ("prlimit", "util-linux"), ("setpriv", "util-linux")):
        if shutil.which(program) is None:
            raise UsageError(
                f"{program} is not installed", place="--policy sandbox:COMMAND", expected=f"the program {program}",
                remedy=f"install it: apt-get install {package}",
            )  # fmt: skip
    return str(shutil.which("bwrap"))


def start_in_sandbox(
    command: str, folder: Path | None, limits: PolicyLimits, variables: Mapping[str, str]
) -> IsolatedProgram:
    """Start a program in a sandbox.

    Args:
        command: the program and its arguments, in the words of a shell; no shell runs it.
        folder: folder that the program sees as ``/policy``, where it starts; None: none.
        limits: its bounds.
        variables: environment variables, beside those of each sandbox.

    Raises:
        UsageError: bubblewrap is not installed.
    """
    reading, writing = os.pipe()
    arguments = build_command(require_bubblewrap(), shlex.split(command), folder, limits, variables, writing)
    root = _Root(reading)
    return IsolatedProgram(arguments, limits, root.find, root.close, environment={}, pass_fds=(writing,))


class _Root:
    """The first process of a sandbox, whose id bubblewrap writes to a pipe."""

    def __init__(self, pipe: int) -> None:
        self._pipe, self._found = pipe, 0
        os.set_blocking(pipe, False)

    def find(self) -> int | None:
        """Return its id as this process sees it; None: it has not begun."""
        if not self._found and self._pipe >= 0:
            try:
                data = os.read(self._pipe, 4096)
            except BlockingIOError:
                return None
            if data:
                self._found = int(decode_json(data)["child-pid"])
        return self._found or None

    def close(self) -> None:
        """Close the pipe."""
        if self._pipe >= 0:
            os.close(self._pipe)
            self._pipe = -1


def build_command(
    bubblewrap: str,
    command: list[str],
    folder: Path | None,
    limits: PolicyLimits,
    variables: Mapping[str, str],
    info_fd: int,
) -> list[str]:
    """Build the command that runs a program in a sandbox.

    Args:
        bubblewrap: path of ``bwrap``.
        command: the program and its arguments.
        folder: folder that the program sees as ``/policy``; None: none.
        limits: its bounds.
        variables: environment variables, beside those of each sandbox.
        info_fd: file descriptor that receives the id of the first process.
    """
    words = [
        str(shutil.which("prlimit")), "--core=0", f"--fsize={limits.disk_bytes}", f"--nofile={_FILES}",
        f"--nproc={limits.processes}", f"--data={limits.memory_bytes}", bubblewrap,
        "--die-with-parent", "--new-session", "--info-fd", str(info_fd), "--unshare-ipc", "--unshare-pid",
        "--unshare-net", "--unshare-uts", "--unshare-cgroup-try", "--hostname", "policy", "--clearenv",
    ]  # fmt: skip
    inner: list[str] = []
    if os.geteuid() == 0:
        # The root user has no bound on processes: the program runs as a user whom nobody else is.
        user = _FIRST_USER + os.getpid()
        words += ["--cap-drop", "ALL", "--cap-add", "CAP_SETUID", "--cap-add", "CAP_SETGID"]
        inner = [str(shutil.which("setpriv")), f"--reuid={user}", f"--regid={user}", "--clear-groups"]
    else:
        words += ["--unshare-user", "--cap-drop", "ALL"]
    for path in _SYSTEM:
        if Path(path).is_symlink():
            words += ["--symlink", str(Path(path).readlink()), path]
        elif Path(path).exists():
            words += ["--ro-bind", path, path]
    roots, packages = _python_folders()
    for path in (*roots, *packages):
        # Bubblewrap gives the folders above the mode of the source, which another user may not enter.
        for above in reversed(Path(path).parents[:-1]):
            words += ["--perms", "0755", "--dir", str(above)]
        words += ["--ro-bind", path, path]
    words += ["--proc", "/proc", "--dev", "/dev"]
    words += ["--perms", "1777", "--size", str(_SHARED_MEMORY), "--tmpfs", "/dev/shm", "--remount-ro", "/dev"]
    words += ["--perms", "1777", "--size", str(limits.disk_bytes), "--tmpfs", "/tmp"]
    words += ["--perms", "0755", "--dir", POLICY_FOLDER]
    if folder is not None:
        for entry in sorted(folder.iterdir()):
            words += ["--ro-bind", str(entry.resolve()), f"{POLICY_FOLDER}/{entry.name}"]
    words += ["--remount-ro", "/", "--chdir", POLICY_FOLDER]
    path = ":".join([f"{sys.prefix}/bin", "/usr/local/bin", "/usr/bin", "/bin"])
    environment = {
        "PATH": path, "HOME": "/tmp", "TMPDIR": "/tmp", "LANG": "C.UTF-8", "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONPATH": ":".join(dict.fromkeys(str(Path(package).parent) for package in packages)),
        "NUMBA_CACHE_DIR": "/tmp", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
        SOCKET_VARIABLE: SOCKET, **variables,
    }  # fmt: skip
    for name, value in environment.items():
        words += ["--setenv", name, value]
    return [*words, "--", *inner, *command]


@lru_cache(maxsize=1)
def _python_folders() -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the folders of this Python and its packages; and the folders of our packages, if they lie elsewhere.

    The folder that holds our packages is not bound: in a checkout it may hold anything.
    """
    wanted = [sys.prefix, sys.base_prefix]
    wanted += [path for path in sys.path if Path(path).name in ("site-packages", "dist-packages")]
    roots: list[str] = []
    for path in dict.fromkeys([*wanted, *map(os.path.realpath, wanted)]):
        if Path(path).is_dir() and not any(_is_in(path, root) for root in (*roots, *_SYSTEM)):
            roots.append(path)
    packages = []
    for name in _PACKAGES:
        spec = find_spec(name)
        if spec is not None and spec.origin is not None:
            package = str(Path(spec.origin).parent)
            if not any(_is_in(package, root) for root in (*roots, *_SYSTEM)):
                packages.append(package)
    return tuple(roots), tuple(packages)


def _is_in(path: str, root: str) -> bool:
    return Path(path).is_relative_to(root) and not Path(root).is_symlink()
