"""How long a method trains: a number of steps, or processor time, which other work on the machine does not shorten."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Final

from numba.core import event

from mirror.errors import UsageError


@dataclass(frozen=True)
class Budget:
    """One of two; schedules run from progress 0 to 1 under either.

    Attributes:
        steps: images trained on. Repeats exactly at the same number of threads.
        core_minutes: processor time of all threads of the process, of training alone: reading ahead counts; rendering
            for reports does not, nor compiling kernels, which happens once a machine. With it, methods are compared at
            equal cost on a machine that does other work too.
    """

    steps: int | None = None
    core_minutes: float | None = None

    def __post_init__(self) -> None:
        if (self.steps is None) == (self.core_minutes is None):
            raise UsageError("a budget is steps or core_minutes", expected="exactly one of them")
        if (self.steps is not None and self.steps < 1) or (self.core_minutes is not None and self.core_minutes <= 0):
            raise UsageError(f"a budget of {self.steps or self.core_minutes}", expected="more than nothing")

    def progress(self, steps: int, spent_s: float) -> float:
        """From 0 to 1, where training ends.

        Args:
            steps: done so far.
            spent_s: processor time so far.
        """
        share = steps / self.steps if self.steps is not None else spent_s / (60.0 * (self.core_minutes or 1.0))
        return min(share, 1.0)


class _Compiling(event.Listener):
    """How much processor time went into kernels that were not on disk yet."""

    def __init__(self) -> None:
        self._before, self._deep, self._since = 0.0, 0, 0.0

    @property
    def spent_s(self) -> float:
        """So far, of what is being compiled too."""
        return self._before + (time.process_time() - self._since if self._deep else 0.0)

    def on_start(self, _: Any) -> None:
        """Numba begins to compile, one kernel at a time; what that calls is compiled within."""
        if not self._deep:
            self._since = time.process_time()
        self._deep += 1

    def on_end(self, _: Any) -> None:
        """It is done."""
        spent_s = self.spent_s
        self._deep -= 1
        if not self._deep:
            self._before = spent_s


_COMPILING: Final = _Compiling()
event.register("numba:compile", _COMPILING)


def _worked_s() -> float:
    """Processor time of this process so far, without compilation."""
    return time.process_time() - _COMPILING.spent_s


class Clock:
    """Processor time of this process without compilation, that can be stopped.

    Args:
        spent_s: where it begins: what an earlier run spent.
    """

    def __init__(self, spent_s: float = 0.0) -> None:
        self._before, self._since = spent_s, _worked_s()
        self._paused = False

    @property
    def spent_s(self) -> float:
        """So far."""
        return self._before + (0.0 if self._paused else _worked_s() - self._since)

    def pause(self) -> None:
        """What follows does not count."""
        self._before, self._paused = self.spent_s, True

    def resume(self) -> None:
        """It counts again."""
        self._since, self._paused = _worked_s(), False
