"""A training run that is interrupted."""

from __future__ import annotations

import signal

from mirror.progress import NullProgress


class InterruptingProgress(NullProgress):
    """Sends Ctrl-C after some steps, as a user may do at any time."""

    def __init__(self, after: int) -> None:
        self._left = after

    def advance(self, steps: int) -> None:
        self._left -= steps
        if self._left == 0:
            signal.raise_signal(signal.SIGINT)
