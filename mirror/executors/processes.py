"""Executor whose workers are processes of this machine, which may crash or hang: such an item fails alone."""

from __future__ import annotations

import multiprocessing
import pickle
import threading
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, cast

from mirror.executors.executor import Worker, WorkerEndedError, WorkersExecutor
from mirror.executors.job import Failure, JobFunction, ParallelJob
from mirror.pools import end_with_parent, one_thread_each, undisturbed


class ProcessesExecutor(WorkersExecutor[Connection]):
    """Worker processes with one thread a library; they end with this process and with the block that opened it.

    A worker that ends or takes too long is replaced. They never hear Ctrl-C, which a terminal sends to all processes of
    a command.

    Args:
        workers: number of processes.
    """

    def make_worker(self, job: ParallelJob[Any, Any]) -> _Process:
        """Make a worker, which starts with its first item."""
        return _Process(job)

    def wait(self, connections: Sequence[Connection], timeout_s: float | None) -> Sequence[Connection]:
        """Return the connections on which something has come."""
        # A connection that ended is ready too.
        return cast(list[Connection], wait(connections, timeout_s))


class _Process(Worker[Connection]):
    """A process with a pipe."""

    starting_s = 120.0

    def __init__(self, job: ParallelJob[Any, Any]) -> None:
        super().__init__(job)
        self._process: BaseProcess | None = None

    @property
    def is_running(self) -> bool:
        return self._process is not None

    def launch(self) -> None:
        # A forked child that enters a parallel numba kernel after its parent did dies.
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        with one_thread_each(), undisturbed():
            self._process = context.Process(target=_serve, args=(theirs, self.job))
            self._process.start()
        theirs.close()

    def send(self, item: Any) -> None:
        if self.connection is not None:
            # If it ended between two items, what comes next says so.
            with suppress(BrokenPipeError, ConnectionResetError):
                self.connection.send(item)

    def receive(self) -> Any:
        try:
            return None if self.connection is None else self.connection.recv()
        except (EOFError, ConnectionResetError) as error:
            raise WorkerEndedError(f"its process ended with code {self._end()}") from error

    def end(self) -> None:
        self._end()

    def _end(self) -> int | None:
        process, self._process = self._process, None
        if process is None:
            return None
        process.join(0.05)
        process.kill()
        process.join()
        if self.connection is not None:
            self.connection.close()
            self.connection = None
        return process.exitcode


def _serve(connection: Connection, job: ParallelJob[Any, Any]) -> None:
    threading.Thread(target=end_with_parent, name="mirror-parent", daemon=True).start()
    function = JobFunction(job)
    connection.send(None)
    while True:
        try:
            item = connection.recv()
        except EOFError:
            return
        answer = function.answer(item)
        try:
            connection.send(answer)
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            # Nothing was sent: an answer is pickled first.
            connection.send(Failure("failed", f"its result cannot be sent: {error}"))
