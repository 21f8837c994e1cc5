"""How long a training lasts: a number of steps, or processor time, which does not depend on other load."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Final

from numba.core import event

from mirror.errors import UsageError


@dataclass(frozen=True)
class Budget:
    """A number of steps or a processor time; under either, schedules run from progress 0 to 1.

    Attributes:
        steps: number of steps. Results repeat exactly with the same number of threads.
        core_minutes: processor time of all threads of the process, spent on training. Reading ahead counts; rendering
            for reports, checkpoints and the compilation of kernels, which happens once on a machine, do not. With this
            budget, methods are compared at equal cost on a machine with other load.
    """

    steps: int | None = None
    core_minutes: float | None = None

    def __post_init__(self) -> None:
        if (self.steps is None) == (self.core_minutes is None):
            raise UsageError("a budget is steps or core_minutes", expected="exactly one of them")
        if (self.steps is not None and self.steps < 1) or (self.core_minutes is not None and self.core_minutes <= 0):
            raise UsageError(f"a budget of {self.steps or self.core_minutes}", expected="more than nothing")

    def progress(self, steps: int, spent_s: float) -> float:
        """Return the progress from 0 to 1, where training ends.

        Args:
            steps: number of steps so far.
            spent_s: processor time so far.
        """
        share = steps / self.steps if self.steps is not None else spent_s / (60.0 * (self.core_minutes or 1.0))
        return min(share, 1.0)


class _CompilationTimer(event.Listener):
    """Measures the processor time of kernel compilation."""

    def __init__(self) -> None:
        self._earlier_s, self._depth, self._started_s = 0.0, 0, 0.0

    @property
    def spent_s(self) -> float:
        """Processor time so far, including the compilation under way."""
        return self._earlier_s + (time.process_time() - self._started_s if self._depth else 0.0)

    def on_start(self, _: Any) -> None:
        """Count the start of a compilation; compilations may nest."""
        if not self._depth:
            self._started_s = time.process_time()
        self._depth += 1

    def on_end(self, _: Any) -> None:
        """Count the end of a compilation."""
        spent_s = self.spent_s
        self._depth -= 1
        if not self._depth:
            self._earlier_s = spent_s


_COMPILATION: Final = _CompilationTimer()
event.register("numba:compile", _COMPILATION)


def _processor_time_s() -> float:
    """Processor time of this process so far, without compilation."""
    return time.process_time() - _COMPILATION.spent_s


class Clock:
    """A clock of the process's processor time without compilation, and of wall time; it can be paused.

    Args:
        spent_s: initial processor time: that of an earlier run.
        wall_s: initial wall time.
    """

    def __init__(self, spent_s: float = 0.0, wall_s: float = 0.0) -> None:
        self._earlier_s, self._earlier_wall_s = spent_s, wall_s
        self.resume()

    @property
    def spent_s(self) -> float:
        """Processor time so far."""
        return self._earlier_s + (0.0 if self._paused else _processor_time_s() - self._started_s)

    @property
    def wall_s(self) -> float:
        """Wall time so far."""
        return self._earlier_wall_s + (0.0 if self._paused else time.monotonic() - self._started_wall_s)

    def pause(self) -> None:
        """Stop counting."""
        self._earlier_s, self._earlier_wall_s, self._paused = self.spent_s, self.wall_s, True

    def resume(self) -> None:
        """Count again."""
        self._started_s, self._started_wall_s, self._paused = _processor_time_s(), time.monotonic(), False
