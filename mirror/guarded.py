"""Work on many items in processes that may crash or hang: such an item fails alone, and the others go on."""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, Self, TypeVar

from mirror.errors import MirrorError
from mirror.pools import end_with_parent, one_thread_each, undisturbed

Item = TypeVar("Item")
Result = TypeVar("Result")
_STARTING_S = 120.0


@dataclass(frozen=True)
class Failure:
    """The reason why an item of parallel work has no result.

    Attributes:
        status: `failed`: an error was raised; `crashed`: the process ended; `hung`: it took longer than allowed.
        problem: what happened, in words.
    """

    status: str
    problem: str


class GuardedPool(Generic[Item, Result]):
    """Worker processes with one thread a library; they end with this process and with the block that opened the pool.

    A worker that ends or takes too long is replaced; the item that it worked on is not tried again. Workers are kept
    from one call of `map` to the next.

    Args:
        make: called once in each worker; returns the function of an item. It can be pickled.
        arguments: of ``make``.
        workers: number of processes.
        timeout_s: longest time for one item; the first item of a worker has two minutes more for imports.
    """

    def __init__(
        self,
        make: Callable[..., Callable[[Item], Result]],
        arguments: tuple[Any, ...],
        *,
        workers: int,
        timeout_s: float,
    ) -> None:
        self._slots: list[_Slot[Item, Result]] = [_Slot(make, arguments, timeout_s) for _ in range(max(workers, 1))]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for slot in self._slots:
            slot.end()

    def map(self, items: Sequence[Item]) -> Iterator[tuple[int, Result | Failure]]:
        """Yield the number of each item with its result, in the order of completion.

        Args:
            items: each is sent to a worker when it is its turn, so that memory stays bounded.
        """
        following = iter(range(len(items)))
        for slot in self._slots:
            if (first := next(following, None)) is not None:
                slot.take(first, items[first])
        while busy := [slot for slot in self._slots if slot.number is not None]:
            pause = max(min(slot.ends_s for slot in busy) - time.monotonic(), 0.0)
            ready = set(wait([slot.connection for slot in busy], pause))
            for slot in busy:
                number = slot.number
                answer = slot.answer(slot.connection in ready)
                if answer is None or number is None:
                    continue
                # The worker begins its next item before this one is handed on.
                if (later := next(following, None)) is not None:
                    slot.take(later, items[later])
                yield number, answer


class _Slot(Generic[Item, Result]):
    """One worker and the item that it works on."""

    def __init__(
        self, make: Callable[..., Callable[[Item], Result]], arguments: tuple[Any, ...], timeout_s: float
    ) -> None:
        self._make, self._arguments, self._timeout_s = make, arguments, timeout_s
        self._process: BaseProcess | None = None
        self.connection: Connection = multiprocessing.Pipe()[0]
        self.number: int | None = None
        self.ends_s = 0.0

    def take(self, number: int, item: Item) -> None:
        """Send an item to the worker, which is started if there is none."""
        starting = self._process is None
        if starting:
            self._start()
        self.number = number
        self.ends_s = time.monotonic() + self._timeout_s + (_STARTING_S if starting else 0.0)
        try:
            self.connection.send(item)
        except (BrokenPipeError, OSError):
            # It ended between two items; the answer says so.
            return

    def answer(self, is_ready: bool) -> Result | Failure | None:
        """The result of the item, or why there is none; None: not yet."""
        if is_ready:
            try:
                answer = self.connection.recv()
            except (EOFError, ConnectionResetError):
                code = self._kill()
                answer = Failure("crashed", f"the process of the detector ended with code {code}")
            self.number = None
            return answer
        if time.monotonic() < self.ends_s:
            return None
        self._kill()
        self.number = None
        return Failure("hung", f"no result after {self._timeout_s:g} s")

    def end(self) -> None:
        """End the worker."""
        self._kill()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        with one_thread_each(), undisturbed():
            self._process = context.Process(target=_serve, args=(theirs, self._make, self._arguments), daemon=True)
            self._process.start()
        theirs.close()

    def _kill(self) -> int | None:
        process, self._process = self._process, None
        if process is None:
            return None
        process.join(0.05)
        process.kill()
        process.join()
        self.connection.close()
        return process.exitcode


def _serve(connection: Connection, make: Callable[..., Callable[[Any], Any]], arguments: tuple[Any, ...]) -> None:
    threading.Thread(target=end_with_parent, name="mirror-parent", daemon=True).start()
    work: Callable[[Any], Any] | None = None
    while True:
        try:
            item = connection.recv()
        except EOFError:
            return
        try:
            work = make(*arguments) if work is None else work
            answer = work(item)
        except MirrorError as error:
            answer = Failure("failed", str(error))
        except Exception as error:  # noqa: BLE001 - a detector is foreign code: its error is the item's result
            answer = Failure("failed", f"{type(error).__name__}: {error}")
        connection.send(answer)
