"""A running program of a policy: watched, and ended with everything that it began."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from hybridworldsim.simulator.isolation.limits import SOCKET, PolicyLimits

_WATCH_S: Final = 0.1
_END_S: Final = 10.0
_SHOWN: Final = 300
_KEPT: Final = 1 << 12
_PAGE: Final = os.sysconf("SC_PAGE_SIZE")


class IsolatedProgram:
    """A program in a file system, a network and a list of processes of its own.

    Args:
        command: the whole command, with the program that keeps it apart.
        limits: bounds, which a thread watches beside those of the system.
        find_root: returns the id of a process in its file system, or None while there is none.
        end: called at the end, for what killing the command does not end.
        environment: environment of the command.
        pass_fds: file descriptors that the command inherits; they are closed here.
    """

    def __init__(
        self,
        command: Sequence[str],
        limits: PolicyLimits,
        find_root: Callable[[], int | None],
        end: Callable[[], None] = lambda: None,
        *,
        environment: Mapping[str, str] | None = None,
        pass_fds: Sequence[int] = (),
    ) -> None:
        self._limits, self._find_root, self._end = limits, find_root, end
        self._output = bytearray()
        self._is_over = threading.Event()
        self._socket = -1
        self.fault: str | None = None
        """Why it was ended before its time; None: it was not."""
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
            env=None if environment is None else dict(environment), pass_fds=tuple(pass_fds), start_new_session=True,
        )  # fmt: skip
        for one in pass_fds:
            os.close(one)
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._read, self._watch)]
        for thread in self._threads:
            thread.start()

    @property
    def is_running(self) -> bool:
        """Return whether it runs."""
        return self._process.poll() is None

    def find_socket(self) -> str | None:
        """Return a path by which this process reaches its socket; None while there is none.

        The program may put a link there, to a socket of this machine: it is not followed.
        """
        if self._socket >= 0:
            return f"/proc/self/fd/{self._socket}"
        root = self._find_root()
        if root is None:
            return None
        try:
            found = os.open(f"/proc/{root}/root{SOCKET}", os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC)
        except OSError:
            return None
        if not stat.S_ISSOCK(os.fstat(found).st_mode):
            os.close(found)
            return None
        self._socket = found
        return f"/proc/self/fd/{found}"

    def describe_end(self) -> str:
        """Describe why it no longer runs, with the end of what it wrote to its error output."""
        if self.fault is not None:
            return self.fault
        said = " ".join(self._output.decode(errors="replace").split())[-_SHOWN:]
        return f"the program ended with {self._process.poll()}" + (f": {said}" if said else "")

    def kill(self) -> None:
        """End it and everything that it began."""
        self._is_over.set()
        self._kill()
        self._process.wait(_END_S)
        for thread in self._threads:
            thread.join(_END_S)
        if self._socket >= 0:
            os.close(self._socket)
            self._socket = -1

    def _kill(self) -> None:
        self._end()
        try:
            os.killpg(self._process.pid, signal.SIGKILL)
        except ProcessLookupError:
            return

    def _read(self) -> None:
        """Keep the end of the error output, so that it neither blocks nor fills a disk."""
        stream = self._process.stderr
        while stream is not None and (data := stream.read1(1 << 14)):  # type: ignore[attr-defined]
            self._output += data
            del self._output[:-_KEPT]

    def _watch(self) -> None:
        while not self._is_over.wait(_WATCH_S) and self.is_running:
            members = list_members(self._process.pid)
            used = sum(memory_of(member) for member in members)
            threads = sum(threads_of(member) for member in members)
            if used > self._limits.memory_bytes:
                self.fault = f"it took more than {self._limits.memory_bytes >> 20} MiB of memory"
            elif threads > self._limits.processes + _OWN:
                self.fault = f"it began more than {self._limits.processes} processes and threads"
            else:
                continue
            self._kill()
            return


_OWN: Final = 4
"""Processes of the program that keeps it apart."""


def list_members(pid: int) -> list[int]:
    """List a process and all its descendants."""
    members = [pid]
    for member in members:
        for task in Path(f"/proc/{member}/task").glob("*/children"):
            try:
                members += map(int, task.read_text().split())
            except OSError:  # it has ended
                continue
    return members


def memory_of(pid: int) -> int:
    """Return the resident memory of a process, bytes; 0 if it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE
    except OSError:
        return 0


def threads_of(pid: int) -> int:
    """Return the number of threads of a process; 0 if it has ended."""
    try:
        return sum(1 for _ in Path(f"/proc/{pid}/task").iterdir())
    except OSError:
        return 0
