"""A job, an attempt at one of its items, and the failure of an item."""

from __future__ import annotations

import pickle
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Generic, Literal, NoReturn, TypeVar

from mirror.errors import DatasetError, MirrorError

Item = TypeVar("Item")
Result = TypeVar("Result")

ATTEMPTS: Final = 3
"""Number of attempts at an item whose worker ends, takes too long or meets an unexpected error."""

Status = Literal["failed", "crashed", "hung"]


@dataclass(frozen=True)
class ParallelJob(Generic[Item, Result]):
    """Work that is done on each of many items, with the same result whichever worker does it.

    An attempt may run beside an earlier one of the same item that was given up and is not dead yet. So the function of
    an item writes under names of its own, commits files that are complete, and returns numbers; it never deletes,
    renames or recovers what another attempt may own.

    Attributes:
        make: called once in each worker with `settings`; returns the function of an item. It can be pickled.
        settings: arguments of `make`; they can be pickled.
        attempts: largest number of attempts at an item. A `MirrorError` is about the item, not about the attempt: it is
            not tried again.
        timeout_s: longest time for one item, beside that of `make`; None: not limited.
    """

    make: Callable[..., Callable[[Item], Result]]
    settings: tuple[Any, ...] = ()
    attempts: int = ATTEMPTS
    timeout_s: float | None = None


@dataclass(frozen=True)
class Failure:
    """The reason why an item has no result.

    Attributes:
        status: `failed`: an error was raised; `crashed`: the process ended; `hung`: it took longer than allowed.
        problem: what happened, in words.
        attempts: number of attempts.
        error: the error that was raised, where it could be sent; None: there is none.
    """

    status: Status
    problem: str
    attempts: int = 1
    error: BaseException | None = None

    @property
    def is_final(self) -> bool:
        """Return whether another attempt would end the same way."""
        return isinstance(self.error, MirrorError)

    def after(self, attempts: int) -> Failure:
        """Return this failure with the number of attempts."""
        return replace(self, attempts=attempts)

    def raise_error(self, place: str, remedy: str) -> NoReturn:
        """Raise the error of the item, or one that says how its worker ended.

        Args:
            place: the item, for messages.
            remedy: what the user can do where the worker ended or took too long.

        Raises:
            DatasetError: there is no error of the item itself.
        """
        if self.error is not None:
            raise self.error
        raise DatasetError(self.problem, place=place, remedy=remedy)


@dataclass(frozen=True)
class Attempt(Generic[Item]):
    """An attempt at an item.

    Attributes:
        number: of the item, from 0 on.
        item: the item.
        count: 1 for the first attempt.
    """

    number: int
    item: Item
    count: int = 1

    def again(self) -> Attempt[Item]:
        """Return the next attempt."""
        return replace(self, count=self.count + 1)


class JobFunction(Generic[Item, Result]):
    """The function of a job in a worker. An error of making it is the failure of each item.

    Args:
        job: the job.
        is_local: whether it is called in the process that reads the answers, which are not sent then.
    """

    def __init__(self, job: ParallelJob[Item, Result], *, is_local: bool = False) -> None:
        self._is_local = is_local
        self._problem: Failure | None = None
        try:
            self._work = job.make(*job.settings)
        except Exception as error:  # noqa: BLE001 - foreign code runs in jobs
            self._problem = self._fail(error)

    def answer(self, item: Item) -> Result | Failure:
        """Do the work on an item, and return its result, or the failure that its error means."""
        if self._problem is not None:
            return self._problem
        try:
            return self._work(item)
        except Exception as error:  # noqa: BLE001 - foreign code runs in jobs: its error is the item's failure
            return self._fail(error)

    def _fail(self, error: Exception) -> Failure:
        if isinstance(error, MirrorError):
            return Failure("failed", str(error), error=error)
        return Failure(
            "failed", f"{type(error).__name__}: {error}", error=error if self._is_local else _sendable(error)
        )


def _sendable(error: Exception) -> Exception | None:
    """Return the error with the place where it was raised as a note; None: it cannot be pickled."""
    error.add_note(f"in a worker:\n{''.join(traceback.format_exception(error)).rstrip()}")
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - classes of foreign code are pickled; the failure says the rest
        return None
    return error
