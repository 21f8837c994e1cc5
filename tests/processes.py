"""Functions that tests run in processes of their own: forks of one that has the libraries, or new interpreters."""

from __future__ import annotations

import atexit
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

ROOT = Path(__file__).resolve().parents[1]
NEVER_S = 240.0
POLL_S = 0.005
_HEAD = 10
_IMPORTED = (
    "torch", "numba", "cv2", "pandas", "pyarrow.parquet", "mirror.evaluation.run", "mirror.ingest.run",
    "mirror.privacy.run", "mirror.synth",
)  # fmt: skip
# The interpreter's own first instants are nobody's to answer for: the clock runs once the command hears signals.
_MARKED = """
import sys
from mirror.stops import Stops
listen = Stops.listen
def marked(self):
    listen(self)
    print('begun', file=sys.stderr, flush=True)
Stops.listen = marked
"""


class Running:
    """A function that runs in a process of its own, which is killed at the end of a ``with`` block, with its children.

    Args:
        work: the function, which is found by its module and name; it takes texts.
        arguments: of it.
        imports: the process imports its libraries; else they are there.

    Attributes:
        process: its number, and that of its group.
        stdout: of all its processes.
        stderr: of all its processes.
    """

    def __init__(self, work: Callable[..., object], *arguments: str | Path, imports: bool = False) -> None:
        self._starter: _Starter = _Interpreters() if imports else _forks()
        self._code: int | None = None
        (stdout, out), (stderr, error) = os.pipe(), os.pipe()
        self.process = self._starter.start(work, [str(argument) for argument in arguments], [out, error])
        os.close(out)
        os.close(error)
        self.stdout, self.stderr = os.fdopen(stdout, "rb"), os.fdopen(stderr, "rb")

    def __enter__(self) -> Running:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self.process, signal.SIGKILL)
        self.stdout.close()
        self.stderr.close()

    def send(self, number: int, *, group: bool = False) -> None:
        """Send a signal to it, or to all its processes."""
        os.killpg(self.process, number) if group else os.kill(self.process, number)

    def wait(self, most_s: float = NEVER_S) -> int | None:
        """Return how it ended, as `subprocess.Popen.returncode` has it; None: it runs."""
        if self._code is None:
            self._code = self._starter.wait(self.process, most_s)
        return self._code

    @contextmanager
    def reading(self) -> Iterator[Callable[[], list[str]]]:
        """Read what its processes print; the function returns it once the last of them has ended."""
        with ThreadPoolExecutor(2) as readers:
            said = [readers.submit(stream.read) for stream in (self.stdout, self.stderr)]
            yield lambda: [one.result(NEVER_S).decode() for one in said]


class _Starter(Protocol):
    """Starts processes, each in a session of its own."""

    def start(self, work: Callable[..., object], arguments: Sequence[str], streams: Sequence[int]) -> int:
        """Start a function that is found by its name; returns the process, which has the number of its group."""

    def wait(self, process: int, most_s: float) -> int | None:
        """Return how a process ended, as `subprocess.Popen.returncode` has it; None: it runs."""


class _Forks:
    """Forks of one process that has imported the libraries."""

    def __init__(self) -> None:
        self._here, there = socket.socketpair()
        code = f"from tests.processes import _serve; _serve({there.fileno()})"
        self._process = subprocess.Popen(
            [sys.executable, "-c", code], env=_environment(), pass_fds=[there.fileno()], start_new_session=True
        )
        there.close()
        self._replies = self._here.makefile("r")
        atexit.register(self._close)

    def start(self, work: Callable[..., object], arguments: Sequence[str], streams: Sequence[int]) -> int:
        request = {"work": [work.__module__, work.__qualname__], "arguments": arguments, "path": sys.path}
        process: int = self._ask({**request, "folder": str(Path.cwd()), "environment": dict(os.environ)}, streams)
        return process

    def wait(self, process: int, most_s: float) -> int | None:
        end_s = time.monotonic() + most_s
        found: int | None
        while (found := self._ask({"process": process})) is None and time.monotonic() < end_s:
            time.sleep(POLL_S)
        return found

    def _ask(self, request: dict[str, object], streams: Sequence[int] = ()) -> Any:
        text = json.dumps(request).encode()
        socket.send_fds(self._here, [f"{len(text):{_HEAD}}".encode()], streams)
        self._here.sendall(text)
        return json.loads(self._replies.readline())

    def _close(self) -> None:
        self._replies.close()
        self._here.close()
        self._process.wait()


class _Interpreters:
    """New interpreters, whose imports are a part of what is interrupted."""

    def __init__(self) -> None:
        self._started: dict[int, subprocess.Popen[bytes]] = {}

    def start(self, work: Callable[..., object], arguments: Sequence[str], streams: Sequence[int]) -> int:
        stdout, stderr = streams
        code = f"{_MARKED}from {work.__module__} import {work.__qualname__} as work; work(*sys.argv[1:])"
        process = subprocess.Popen(
            [sys.executable, "-c", code, *arguments],
            env=_environment(), stdout=stdout, stderr=stderr, start_new_session=True, preexec_fn=hear,
        )  # fmt: skip
        self._started[process.pid] = process
        return process.pid

    def wait(self, process: int, most_s: float) -> int | None:
        with suppress(subprocess.TimeoutExpired):
            self._started[process].wait(most_s)
        return self._started[process].returncode


@cache
def _forks() -> _Forks:
    return _Forks()


def _serve(descriptor: int) -> None:
    """Fork what is asked for until the other side closes the socket; in a fork this returns when its work is done."""
    # Those that a computer lacks, no test on it asks for.
    for name in _IMPORTED:
        with suppress(ModuleNotFoundError):
            import_module(name)
    asked = socket.socket(fileno=descriptor)
    while True:
        head, streams, *_ = socket.recv_fds(asked, _HEAD, 2)
        if not head:
            return
        request = json.loads(asked.recv(int(head), socket.MSG_WAITALL))
        if "process" in request:
            ended, status = os.waitpid(request["process"], os.WNOHANG)
            reply = os.waitstatus_to_exitcode(status) if ended else None
        elif reply := os.fork():
            for stream in streams:
                os.close(stream)
        else:
            asked.close()
            _work(request, streams)
            return
        asked.sendall(f"{json.dumps(reply)}\n".encode())


def _work(request: dict[str, Any], streams: Sequence[int]) -> None:
    os.setsid()
    hear()
    for number, stream in enumerate(streams, 1):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.path[:] = request["path"]
    exec(_MARKED, {})
    module, name = request["work"]
    getattr(import_module(module), name)(*request["arguments"])


def hear() -> None:
    """Undo that the shell of a test run in the background ignores Ctrl-C."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _environment() -> dict[str, str]:
    return {**os.environ, "OMP_WAIT_POLICY": "passive", "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
