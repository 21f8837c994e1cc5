"""Jobs in this process and in processes that may crash or hang; the same contract on Ray in `test_ray.py`."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mirror.errors import DatasetError, UsageError
from mirror.executors.choice import ExecutorChoice
from mirror.executors.executor import Executor, SerialExecutor
from mirror.executors.job import Failure, ParallelJob
from mirror.executors.processes import ProcessesExecutor
from tests.executors import jobs


def attempts_at(folder: Path, item: int) -> int:
    return (folder / f"{item}.attempts").stat().st_size


def require_contract(executor: Executor, folder: Path, timeout_s: float = 0.5) -> None:
    """Items fail alone, after at most three attempts, and all others have their results."""
    job: ParallelJob[int, Any] = ParallelJob(jobs.make, (10, str(folder)), timeout_s=timeout_s)
    poison = [jobs.CRASHING, jobs.ENDLESS, jobs.REFUSED, jobs.BROKEN, jobs.UNSENDABLE]
    items = [*range(10), *poison, jobs.FLAKY, *range(10, 20)]
    answers = {items[number]: answer for number, answer in executor.map(job, items)}
    assert {item: answers[item] for item in range(20)} == {0: None, **{item: 10 * item for item in range(1, 20)}}
    assert answers[jobs.FLAKY] == 10 * jobs.FLAKY
    failures = [answers[item] for item in poison]
    assert [(one.status, one.attempts) for one in failures] == [
        ("crashed", 3), ("hung", 3), ("failed", 1), ("failed", 3), ("failed", 3)
    ]  # fmt: skip
    assert [attempts_at(folder, item) for item in [*poison, jobs.FLAKY, 19]] == [3, 3, 1, 3, 3, 3, 1]
    assert isinstance(failures[2].error, UsageError) and failures[2].problem == "refused"
    assert isinstance(failures[3].error, ValueError)
    assert any("jobs.py" in note for note in failures[3].error.__notes__)
    assert f"no result after {timeout_s:g} s" in failures[1].problem and "cannot be sent" in failures[4].problem


def test_items_fail_alone_in_processes(tmp_path: Path) -> None:
    with ProcessesExecutor(2) as executor:
        require_contract(executor, tmp_path)


def test_in_this_process_each_item_is_tried_once_in_order(tmp_path: Path) -> None:
    job: ParallelJob[int, Any] = ParallelJob(jobs.make, (10, str(tmp_path)))
    answers = list(SerialExecutor().map(job, [2, jobs.BROKEN, jobs.REFUSED, 1]))
    assert [number for number, _ in answers] == [0, 1, 2, 3]
    assert answers[0][1] == 20 and answers[3][1] == 10
    broken, refused = answers[1][1], answers[2][1]
    assert (broken.status, broken.attempts, type(refused.error)) == ("failed", 1, UsageError)
    assert attempts_at(tmp_path, jobs.BROKEN) == 1


def test_items_are_taken_when_a_worker_is_free(tmp_path: Path) -> None:
    taken = 0

    def count() -> Iterator[int]:
        nonlocal taken
        for number in range(1, 51):
            taken = number
            yield number

    with ProcessesExecutor(2) as executor:
        ahead = max(
            taken - done for done, _ in enumerate(executor.map(ParallelJob(jobs.make, (1, str(tmp_path))), count()))
        )
    # Two at work, one looked at, those that are done and not yet handed on.
    assert taken == 50 and ahead <= 5


def test_workers_are_kept_for_the_same_job_and_end_with_the_block(tmp_path: Path) -> None:
    job: ParallelJob[int, Any] = ParallelJob(jobs.make, (10, str(tmp_path)))
    with ProcessesExecutor(1) as executor:
        assert dict(executor.map(job, [1])) == {0: 10}
        first = executor._team[0]._process  # type: ignore[attr-defined]
        assert dict(executor.map(job, [2])) == {0: 20}
        assert executor._team[0]._process is first  # type: ignore[attr-defined]
        assert dict(executor.map(job, [])) == {}
    assert not first.is_alive()


def test_a_caller_that_stops_reading_ends_what_is_at_work(tmp_path: Path) -> None:
    job: ParallelJob[int, Any] = ParallelJob(jobs.make, (1, str(tmp_path)))
    began = time.monotonic()
    with ProcessesExecutor(2) as executor:
        for _ in executor.map(job, [1, jobs.ENDLESS]):
            break
    assert time.monotonic() - began < 30


def test_an_error_of_making_the_job_is_that_of_each_item(tmp_path: Path) -> None:
    job: ParallelJob[int, Any] = ParallelJob(jobs.fail_to_make, (1, str(tmp_path)))
    for kind in ("serial", "processes"):
        with ExecutorChoice(kind, 1).open() as executor:
            answers = [answer for _, answer in executor.map(job, [1, 2])]
        assert all(isinstance(one, Failure) and "no model" in one.problem for one in answers)
        with pytest.raises(UsageError, match="no model"):
            answers[0].raise_error("1", "none")


def test_workers_that_cannot_start_end_the_run(tmp_path: Path) -> None:
    with ProcessesExecutor(1) as executor, pytest.raises(DatasetError, match=r"cannot start.*code 7.*--workers"):
        list(executor.map(ParallelJob(jobs.end_process, (1, str(tmp_path))), [1]))


def test_libraries_of_a_worker_have_one_thread() -> None:
    with ProcessesExecutor(1) as executor:
        assert dict(executor.map(ParallelJob(jobs.thread_limits), [1])) == {0: (1, 1)}


def test_no_worker_hears_ctrl_c_not_even_the_first_of_a_process() -> None:
    """The first process that `multiprocessing` starts is preceded by its own tracker of resources."""
    code = (
        "from mirror.executors.job import ParallelJob\n"
        "from mirror.executors.processes import ProcessesExecutor\n"
        "from tests.executors.jobs import signals_held_back\n"
        "with ProcessesExecutor(2) as executor:\n"
        "    assert sorted(executor.map(ParallelJob(signals_held_back), [0, 1])) == [(0, True), (1, True)]\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[2], check=True)


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"kind": "serial", "address": "auto"}, "--address.*--executor ray"),
        ({"kind": "processes", "resources": {"GPU": 1.0}}, "--resource.*--executor ray"),
        ({"workers": 0}, "--workers"),
    ],
)
def test_options_of_another_executor_are_refused(choice: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        ExecutorChoice(**choice)
