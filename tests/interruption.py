"""The one harness of interruption: work is stopped at a chosen point, so that a test resumes it and compares the bytes.

From the quickest to the truest:

- `interrupt_before` and `interrupt_at_call` send Ctrl-C to this process: before a file gets its name, or at a
  call of an object that the test hands over. No function of the code under test is replaced.
- `kill_before` ends a fork at such a point with SIGKILL, so that nothing tidies up.
- `interrupt` sends a signal, as a terminal or a scheduler does, to a command with its worker processes, at any instant.

Forks are those of one process that has imported the libraries and computed nothing.
"""

from __future__ import annotations

import atexit
import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path, PurePath
from typing import Any, ParamSpec, Protocol, TypeVar

from mirror.progress import NullProgress

ROOT = Path(__file__).resolve().parents[1]
MOST_S = 5.0
NEVER_S = 240.0
# A signal of a terminal, of `kill -INT`, and of a scheduler.
SIGNALS = ((signal.SIGINT, True), (signal.SIGINT, False), (signal.SIGTERM, True))
_POLL_S = 0.005
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
_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
_Thing = TypeVar("_Thing")


@dataclass
class _Point:
    """The instant before a file or folder gets its name: it is made, renamed or linked.

    Attributes:
        pattern: of the end of its path, as `PurePath.match` has it.
        count: how many of them there must be; it is the last.
        number: the signal that is sent then.
    """

    pattern: str
    count: int
    number: int

    def see(self, path: str) -> None:
        if PurePath(path).match(self.pattern):
            self.count -= 1
            if self.count == 0:
                # In a thread other than the main one, the main one hears it.
                signal.raise_signal(self.number)


_point: _Point | None = None


@cache
def _observe() -> None:
    """Observe what this process places. Such a hook cannot be taken away again."""

    def see(event: str, arguments: tuple[Any, ...]) -> None:
        if _point is None:
            return
        if event in ("os.rename", "os.link"):
            _point.see(str(arguments[1]))
        elif event == "open" and arguments[2] & os.O_CREAT:
            _point.see(str(arguments[0]))

    sys.addaudithook(see)


@contextmanager
def interrupt_before(pattern: str, count: int = 1, number: int = signal.SIGINT) -> Iterator[None]:
    """Send Ctrl-C in the block before a file or folder gets its name, and take the `KeyboardInterrupt`.

    Args:
        pattern: of the end of its path, such as ``layers/*/*`` or ``*.png``.
        count: for the how-manieth of them; 1: the first.
        number: another signal.
    """
    global _point
    _observe()
    _point = point = _Point(pattern, count, number)
    try:
        with suppress(KeyboardInterrupt):
            yield
    finally:
        _point = None
    assert point.count <= 0, f"{pattern} was to be placed {point.count} times more"


def interrupt_at_call(function: Callable[_Arguments, _Result], count: int) -> Callable[_Arguments, _Result]:
    """Return a function that sends Ctrl-C at its ``count``-th call (from 1), and then does what the given one does."""
    calls = 0

    def called(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        nonlocal calls
        calls += 1
        if calls == count:
            signal.raise_signal(signal.SIGINT)
        return function(*args, **kwargs)

    return called


def interrupting(thing: _Thing, method: str, count: int) -> _Thing:
    """Return an object that a test hands over, whose method sends Ctrl-C at its ``count``-th call (from 1)."""
    setattr(thing, method, interrupt_at_call(getattr(thing, method), count))
    return thing


class InterruptingProgress(NullProgress):
    """Sends Ctrl-C once, after a number of steps.

    Args:
        after: number of steps; 0: at the start of the phase.
        phases: how many phases pass before the steps count.
    """

    def __init__(self, after: int, phases: int = 0) -> None:
        self._left, self._starts, self._sent = after, phases + 1 if phases else 0, False

    def start(self, phase: str, total: int) -> None:
        self._starts -= 1
        self._count(0)

    def advance(self, steps: int) -> None:
        self._count(steps)

    def _count(self, steps: int) -> None:
        if self._starts <= 0:
            self._left -= steps
            if self._left <= 0 and not self._sent:
                self._sent = True
                signal.raise_signal(signal.SIGINT)


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes:
        code: its exit code; of one that a signal ended, minus its number.
        taken_s: from the signal, or from the start if it had none, to the end of the last of its processes.
        stdout: of all its processes.
        stderr: of all its processes.
        hit: whether the signal ended it; one that came when hardly any work was left does not.
    """

    code: int
    taken_s: float
    stdout: str
    stderr: str
    hit: bool

    def require_stopped(self, says: str = "interrupted: run the same command again") -> None:
        assert self.code == 130, self
        assert self.taken_s < MOST_S, self
        assert "Traceback" not in self.stderr and "Exception ignored" not in self.stderr, self.stderr
        assert "Error" not in self.stderr, self.stderr
        assert self.stderr.count(says) == 1, self.stderr


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
        code = f"from tests.interruption import _serve; _serve({there.fileno()})"
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
            time.sleep(_POLL_S)
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


def _command(*words: str) -> None:
    from mirror.cli.main import main

    sys.argv = ["mirror", *words]
    sys.exit(main())


def _die_before(pattern: str, count: str, module: str, name: str, *arguments: str) -> None:
    global _point
    _observe()
    _point = _Point(pattern, int(count), signal.SIGKILL)
    getattr(import_module(module), name)(*arguments)


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


def interrupt(
    words: Sequence[str | Path],
    after_s: float,
    number: int = signal.SIGINT,
    *,
    group: bool = True,
    once: Callable[[], bool] = lambda: True,
    imports: bool = False,
) -> Ended:
    """Start a command and send it a signal.

    Args:
        words: those after ``mirror``.
        after_s: seconds from when it hears signals.
        number: which signal.
        group: send it to all its processes, as a terminal does; else to the first alone.
        once: the seconds count once this is true.
        imports: it imports its libraries; else they are there.
    """
    with Running(_command, *words, imports=imports) as running:
        assert running.stderr.readline() == b"begun\n"
        with running.reading() as said:
            last = time.monotonic() + NEVER_S
            while (code := running.wait(0.0)) is None and not once() and time.monotonic() < last:
                time.sleep(_POLL_S)
            if hit := code is None and (code := running.wait(after_s)) is None:
                running.send(number, group=group)
            since = time.monotonic()
            # The pipes close with the last process that holds them.
            texts = said()
            taken_s = time.monotonic() - since
        code = running.wait() if code is None else code
    assert code is not None
    return Ended(code, taken_s, *texts, hit and not (code == 0 and taken_s < MOST_S))


def stop_thrice(words: Sequence[str | Path], longest_s: float, seed: int) -> int:
    """Interrupt a command at three random instants; each run continues the one before.

    Returns:
        How many of the runs the signals ended; the others were complete before.
    """
    instants, hits = random.Random(seed), 0
    for number, group in SIGNALS:
        ended = interrupt(words, instants.uniform(0.0, longest_s), number, group=group)
        hits += ended.hit
        if ended.hit:
            ended.require_stopped()
    assert hits
    return hits


def finish(words: Sequence[str | Path]) -> float:
    """Run a command to its end, and return the duration in seconds."""
    begin = time.monotonic()
    ended = interrupt(words, NEVER_S)
    assert not ended.hit and ended.code == 0, ended
    return time.monotonic() - begin


def kill_before(pattern: str, count: int, work: Callable[..., object], *arguments: str | Path) -> None:
    """Call a function in a fork, and kill it before a file or folder gets its name.

    Args:
        pattern: of the end of its path, as for `interrupt_before`.
        count: for the how-manieth of them; 1: the first.
        work: found by its module and name; it takes texts.
        arguments: of it.
    """
    named = (pattern, str(count), work.__module__, work.__qualname__, *arguments)
    with Running(_die_before, *named) as running, running.reading() as said:
        texts = said()
        assert running.wait() == -signal.SIGKILL, texts


def kill_command_before(pattern: str, count: int, words: Sequence[str | Path]) -> None:
    """Kill a command before a file or folder gets its name; see `kill_before`."""
    kill_before(pattern, count, _command, *words)
