"""Opening files of a recording."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from mirror.errors import RecordingError
from mirror.recordings.opening import read_file


def test_pipe_is_refused_without_waiting_for_a_writer(tmp_path: Path) -> None:
    pipe = tmp_path / "poses.csv"
    os.mkfifo(pipe)

    def fail(*_: object) -> None:
        raise TimeoutError(f"{pipe} is waited for")

    previous = signal.signal(signal.SIGALRM, fail)
    signal.setitimer(signal.ITIMER_REAL, 5.0)
    try:
        with pytest.raises(RecordingError, match="no plain file"):
            read_file(pipe)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)
