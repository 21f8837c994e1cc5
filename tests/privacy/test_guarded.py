"""Work in processes that may crash or hang."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

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
