"""The one harness of interruption: work is stopped at a chosen point, so that a test resumes it and compares the bytes.

From the quickest to the truest:

- `interrupt_before` and `interrupt_at_call` send Ctrl-C to this process: before a file gets its name, or at a
  call of an object that the test hands over. No function of the code under test is replaced.
- `kill_before` ends a fork at such a point with SIGKILL, so that nothing tidies up.
- `interrupt` sends a signal, as a terminal or a scheduler does, to a command with its worker processes, at any instant.

Forks are those of one process that has imported the libraries and computed nothing.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path, PurePath
from typing import Any, ParamSpec, TypeVar

from mirror.progress import NullProgress
from tests.processes import NEVER_S, POLL_S, Running

MOST_S = 5.0
# A signal of a terminal, of `kill -INT`, and of a scheduler.
SIGNALS = ((signal.SIGINT, True), (signal.SIGINT, False), (signal.SIGTERM, True))
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


def _command(*words: str) -> None:
    from mirror.cli.main import main

    sys.argv = ["mirror", *words]
    sys.exit(main())


def _die_before(pattern: str, count: str, module: str, name: str, *arguments: str) -> None:
    global _point
    _observe()
    _point = _Point(pattern, int(count), signal.SIGKILL)
    getattr(import_module(module), name)(*arguments)


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
                time.sleep(POLL_S)
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
