"""One interface of executors: `map` a job over items, wherever the workers are."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Generic, NamedTuple, Self, TypeVar

from mirror.errors import DatasetError
from mirror.executors.job import ATTEMPTS, Attempt, Failure, Item, JobFunction, ParallelJob, Result

Connection = TypeVar("Connection")


class Executor(ABC):
    """A place where jobs run; its workers end with the block that opened it."""

    is_local: bool = False
    """True where jobs run in this process, so that neither they nor their results are pickled."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @abstractmethod
    def map(self, job: ParallelJob[Item, Result], items: Iterable[Item]) -> Iterator[tuple[int, Result | Failure]]:
        """Yield the number of each item with its result or failure, in the order of completion.

        Items are taken when a worker is free, so that memory does not grow with their number. Workers are kept from one
        call to the next of the same job. A caller that stops reading ends the workers that are busy.

        Args:
            job: the work.
            items: each is sent to one worker at a time.

        Raises:
            DatasetError: workers cannot be started.
        """

    @abstractmethod
    def close(self) -> None:
        """End all workers."""


class SerialExecutor(Executor):
    """Runs jobs in this process, one item after another and each once, without time limits."""

    is_local = True

    def map(self, job: ParallelJob[Item, Result], items: Iterable[Item]) -> Iterator[tuple[int, Result | Failure]]:
        """Yield results in the order of the items; a crash or an endless loop ends or holds up this process."""
        function = JobFunction(job, is_local=True)
        for number, item in enumerate(items):
            yield number, function.answer(item)

    def close(self) -> None:
        """Do nothing."""


class Answer(NamedTuple):
    """The answer of a worker to an attempt.

    Attributes:
        value: the result, or a `Failure`.
    """

    value: Any


class WorkerEndedError(Exception):
    """A worker has ended without an answer."""


class Worker(ABC, Generic[Connection]):
    """A process that does one item at a time; it is started when it is needed, and again where it ended.

    Args:
        job: the work.

    Attributes:
        attempt: what it works on; None: nothing.
        connection: where the answer will come, or the word that the worker has started; None: nothing will come.
        ends_s: when the attempt or the start is given up, on the monotonic clock.
    """

    starting_s = math.inf
    """Longest time of a start."""

    def __init__(self, job: ParallelJob[Any, Any]) -> None:
        self.job = job
        self.attempt: Attempt[Any] | None = None
        self.connection: Connection | None = None
        self.ends_s = math.inf
        self._has_started = False
        self._failed_starts = 0

    def start(self) -> bool:
        """Start the process unless it runs, and return whether it takes an item now."""
        if not self.is_running:
            self._has_started = False
            self.ends_s = time.monotonic() + self.starting_s
            self.launch()
        return self._has_started

    def take(self, attempt: Attempt[Any]) -> None:
        """Begin an attempt."""
        self.attempt = attempt
        self.ends_s = math.inf if self.job.timeout_s is None else time.monotonic() + self.job.timeout_s
        self.send(attempt.item)

    def answer(self, *, is_ready: bool) -> Answer | None:
        """Return the answer to the attempt, a failure where it takes too long, or None: neither yet.

        Raises:
            DatasetError: the worker cannot be started.
        """
        if not is_ready:
            if time.monotonic() < self.ends_s:
                return None
            self.end()
            if self.attempt is None:
                self._count_failed_start(f"no sign of it after {self.starting_s:g} s")
                return None
            return Answer(Failure("hung", f"no result after {self.job.timeout_s:g} s"))
        try:
            value = self.receive()
        except WorkerEndedError as error:
            self.end()
            if self.attempt is None:
                self._count_failed_start(str(error))
                return None
            return Answer(Failure("crashed", str(error)))
        if self._has_started:
            return Answer(value)
        self.greet(value)
        self._has_started, self._failed_starts, self.ends_s = True, 0, math.inf
        return None

    def _count_failed_start(self, problem: str) -> None:
        self._failed_starts += 1
        if self._failed_starts >= ATTEMPTS:
            raise DatasetError(
                f"a worker cannot start: {problem}", place="--executor",
                expected="this toolkit with the same extras wherever a worker starts, and memory for it",
                remedy="install it there, or give fewer --workers",
            )  # fmt: skip

    @property
    @abstractmethod
    def is_running(self) -> bool:
        """Return whether the process was launched and has not ended, as far as is known."""

    @abstractmethod
    def launch(self) -> None:
        """Launch the process, which makes the job's function and says on the connection that it has."""

    @abstractmethod
    def send(self, item: Any) -> None:
        """Send an item."""

    @abstractmethod
    def receive(self) -> Any:
        """Return what has come on the connection.

        Raises:
            WorkerEndedError: the process has ended.
        """

    def greet(self, word: Any) -> None:
        """Take the word with which the worker has started."""

    @abstractmethod
    def end(self) -> None:
        """End the process, whatever it does."""


class _Attempts(Generic[Item]):
    """The attempts that are to be made: failed ones again first, then one for each item that is left."""

    def __init__(self, items: Iterable[Item]) -> None:
        self._items = enumerate(items)
        self._following: deque[Attempt[Item]] = deque()

    def __bool__(self) -> bool:
        if not self._following and (following := next(self._items, None)) is not None:
            self._following.append(Attempt(*following))
        return bool(self._following)

    def pop(self) -> Attempt[Item]:
        return self._following.popleft()

    def again(self, attempt: Attempt[Item]) -> None:
        self._following.append(attempt.again())


class WorkersExecutor(Executor, Generic[Connection]):
    """An executor with workers beside this process.

    Args:
        workers: number of workers.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._job: ParallelJob[Any, Any] | None = None
        self._team: list[Worker[Connection]] = []

    @abstractmethod
    def make_worker(self, job: ParallelJob[Any, Any]) -> Worker[Connection]:
        """Make a worker, which starts when it is needed."""

    @abstractmethod
    def wait(self, connections: Sequence[Connection], timeout_s: float | None) -> Sequence[Connection]:
        """Return the connections on which something has come; none: the time is over."""

    def map(self, job: ParallelJob[Item, Result], items: Iterable[Item]) -> Iterator[tuple[int, Result | Failure]]:
        """Yield results in the order of completion; see `Executor.map`."""
        team, attempts = self._open_team(job), _Attempts(items)
        done: list[tuple[int, Result | Failure]] = []
        try:
            while True:
                for worker in team:
                    if worker.attempt is None and attempts and worker.start():
                        worker.take(attempts.pop())
                # The workers are busy before anything is handed on.
                yield from done
                done = []
                asked = [one for one in team if one.attempt is not None or (attempts and one.connection is not None)]
                if not asked:
                    return
                for worker, answer in self._answers(asked):
                    attempt, worker.attempt, worker.ends_s = worker.attempt, None, math.inf
                    if attempt is None:
                        continue
                    if not isinstance(answer, Failure):
                        done.append((attempt.number, answer))
                    elif answer.is_final or attempt.count >= job.attempts:
                        done.append((attempt.number, answer.after(attempt.count)))
                    else:
                        attempts.again(attempt)
        finally:
            for worker in team:
                if worker.attempt is not None:
                    worker.end()
                    worker.attempt, worker.ends_s = None, math.inf

    def _answers(self, asked: Sequence[Worker[Connection]]) -> Iterator[tuple[Worker[Connection], Any]]:
        pause_s = min(worker.ends_s for worker in asked) - time.monotonic()
        connections = [one for worker in asked if (one := worker.connection) is not None]
        ready = set(self.wait(connections, None if math.isinf(pause_s) else max(pause_s, 0.0)))
        for worker in asked:
            answer = worker.answer(is_ready=worker.connection in ready)
            if answer is not None:
                yield worker, answer.value

    def close(self) -> None:
        """End all workers."""
        self._end_team()

    def _end_team(self) -> None:
        for worker in self._team:
            worker.end()
        self._team, self._job = [], None

    def _open_team(self, job: ParallelJob[Any, Any]) -> list[Worker[Connection]]:
        if self._job is not job:
            self._end_team()
            self._job = job
            self._team = [self.make_worker(job) for _ in range(self.workers)]
        return self._team
