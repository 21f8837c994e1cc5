"""Work in processes that may crash or hang."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from mirror.errors import UsageError
from mirror.guarded import Failure, GuardedPool


def make(factor: int) -> Callable[[int], int]:
    calls = []

    def work(item: int) -> int:
        calls.append(item)
        if item == 3:
            os._exit(9)
        if item == 5:
            time.sleep(60)
        if item == 7:
            raise UsageError("seven")
        return factor * item

    return work


def test_items_fail_alone_and_workers_are_kept() -> None:
    with GuardedPool(make, (10,), workers=1, timeout_s=1.0) as pool:
        assert dict(pool.map([0, 1])) == {0: 0, 1: 10}
        answers = dict(pool.map([2, 3, 4, 7, 5, 6]))
        assert [answers[number] for number in (0, 2, 5)] == [20, 40, 60]
        failures = [answers[number] for number in (1, 3, 4)]
        assert all(isinstance(one, Failure) for one in failures)
        assert [one.status for one in failures] == ["crashed", "failed", "hung"]
        assert "code 9" in failures[0].problem and "seven" in failures[1].problem
        assert dict(pool.map([])) == {}


def is_held_back(make: int) -> Callable[[int], bool]:
    return lambda item: signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_no_worker_hears_ctrl_c_not_even_the_first_of_a_process() -> None:
    """The first process that `multiprocessing` starts is preceded by its own tracker of resources."""
    code = (
        "from mirror.guarded import GuardedPool\n"
        "from tests.privacy.test_guarded import is_held_back\n"
        "with GuardedPool(is_held_back, (0,), workers=2, timeout_s=60.0) as pool:\n"
        "    assert sorted(pool.map([0, 1])) == [(0, True), (1, True)]\n"
    )
    root = Path(__file__).parents[2]
    subprocess.run([sys.executable, "-c", code], cwd=root, check=True)
