"""Interrupts commands as a terminal or a scheduler does, and holds them to what they owe then."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

MOST_S = 5.0
NEVER_S = 240.0
# A signal of a terminal, of `kill -INT`, and of a scheduler.
SIGNALS = ((signal.SIGINT, True), (signal.SIGINT, False), (signal.SIGTERM, True))
MIRROR = (sys.executable, "-m", "mirror.cli.main")
# The interpreter's own first instants are nobody's to answer for: the clock runs once the command hears signals.
_MARKED = """
import runpy, sys
from mirror.stops import Stops
listen = Stops.listen
def marked(self):
    listen(self)
    print('begun', file=sys.stderr, flush=True)
Stops.listen = marked
"""


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes:
        code: its exit code.
        taken_s: from the signal, or from the start if it had none, to the end of the last of its processes.
        stdout: of all its processes.
        stderr: of all its processes.
        hit: whether the signal came while there was more than a second of work left.
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


def hear_again() -> None:
    """In a process that starts: undo that the shell of a test run in the background ignores Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def interrupt(
    words: Sequence[str | Path],
    after_s: float,
    number: int = signal.SIGINT,
    *,
    group: bool = True,
    once: Callable[[], bool] = lambda: True,
) -> Ended:
    """Start a command and send it a signal.

    Args:
        words: the command.
        after_s: seconds from when it hears signals.
        number: which signal.
        group: send it to all its processes, as a terminal does; else to the first alone.
        once: the seconds count once this is true.
    """
    module = words[words.index("-m") + 1]
    rest = [str(word) for word in words[words.index("-m") + 2 :]]
    code = f"{_MARKED}sys.argv = [{module!r}, *sys.argv[1:]]; runpy.run_module({module!r}, run_name='__main__')"
    running = subprocess.Popen(
        [sys.executable, "-c", code, *rest],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        preexec_fn=hear_again,
    )
    assert running.stdout is not None and running.stderr is not None
    try:
        assert running.stderr.readline() == b"begun\n"
        hit, last = True, time.monotonic() + NEVER_S
        while not once() and running.poll() is None and time.monotonic() < last:
            time.sleep(0.05)
        try:
            running.wait(after_s)
            hit = False
        except subprocess.TimeoutExpired:
            os.killpg(running.pid, number) if group else os.kill(running.pid, number)
        since = time.monotonic()
        # The pipes close with the last process that holds them.
        stdout, stderr = running.communicate(timeout=60.0)
        taken_s = time.monotonic() - since
    finally:
        if running.poll() is None or _alive(running.pid):
            os.killpg(running.pid, signal.SIGKILL)
    hit = hit and not (running.returncode == 0 and taken_s < 1.0)
    return Ended(running.returncode, taken_s, stdout.decode(), stderr.decode(), hit)


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


def _alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True
