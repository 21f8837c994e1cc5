"""Signals while a rollout is driven and while images are served: exit code 130, and a log that is complete."""

from __future__ import annotations

import signal
import socket
from pathlib import Path

import numpy as np
import pytest

from mirror.dataset.dataset import Dataset
from mirror.metrics.safety import read_state_log
from mirror.schema.rollout import ROLLOUT, STATES_FILE
from tests.interruption import interrupt


@pytest.mark.parametrize(("number", "after_s"), [(signal.SIGINT, 0.5), (signal.SIGTERM, 1.0)])
def test_a_rollout_that_is_stopped_has_the_states_up_to_there(
    tiny_dataset: Dataset, tmp_path: Path, number: int, after_s: float
) -> None:
    run = tmp_path / "run"
    words = ["simulate", tiny_dataset.root, "--scenario", "cut-in", "--policy", "idm", "--duration", "120"]
    # The video's temporary file is written once the rollout is driven.
    ended = interrupt(
        [*words, "--renderer", "boxes", "--out", run], after_s, number, once=lambda: any(run.glob(".video*"))
    )
    assert ended.hit
    ended.require_stopped()
    log = read_state_log(run / STATES_FILE)
    assert len(log.stamps_ns) > 1
    assert set(np.diff(log.stamps_ns).tolist()) == {100_000_000}
    assert not (run / ROLLOUT).exists()


def listens(port: int) -> bool:
    with socket.socket() as asked:
        return asked.connect_ex(("127.0.0.1", port)) == 0


def test_a_server_ends_with_ctrl_c() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    ended = interrupt(["serve", "synth:tiny", "--port", str(port)], 0.5, once=lambda: listens(port))
    ended.require_stopped("mirror serve: stopped")
    assert "SensorsimService at 127.0.0.1:" in ended.stdout
