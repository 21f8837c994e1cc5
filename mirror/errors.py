"""Errors that name the file, the place, the expectation and the remedy; and the exit codes of every verb."""

from __future__ import annotations

from enum import IntEnum
from pathlib import PurePath
from typing import Final


class ExitCode(IntEnum):
    """Exit codes of every ``mirror`` verb."""

    DONE = 0
    FINDINGS = 1
    COULD_NOT_RUN = 2
    PARTLY_DONE = 3


class MirrorError(Exception):
    """An error that the user can act on.

    Args:
        problem: what is wrong, with the offending value.
        file: the file or folder at fault.
        place: the place in it: a row, a column, a key, a camera.
        expected: what a right value is.
        remedy: what the user can do.

    Attributes:
        command: the command as it is typed, where that is more than the verb; None: it is the verb.
    """

    def __init__(
        self,
        problem: str,
        *,
        file: str | PurePath | None = None,
        place: str | None = None,
        expected: str | None = None,
        remedy: str | None = None,
    ) -> None:
        self.problem = problem
        self.file = None if file is None else str(file)
        self.place = place
        self.expected = expected
        self.remedy = remedy
        self.command: str | None = None
        super().__init__(problem)

    def __str__(self) -> str:
        where = ": ".join(part for part in (self.file, self.place) if part)
        text = f"{where}: {self.problem}" if where else self.problem
        if self.expected:
            text += f"; expected {self.expected}"
        if self.remedy:
            text += f". Remedy: {self.remedy}"
        return text

    def __reduce__(self) -> tuple[object, ...]:
        return (_rebuild, (type(self), self.problem, self.file, self.place, self.expected, self.remedy))

    def to_dict(self) -> dict[str, str | None]:
        """Return the parts of the error, for ``--json``."""
        return {
            "error": type(self).__name__,
            "problem": self.problem,
            "file": self.file,
            "place": self.place,
            "expected": self.expected,
            "remedy": self.remedy,
        }


def _rebuild(
    kind: type[MirrorError],
    problem: str,
    file: str | None,
    place: str | None,
    expected: str | None,
    remedy: str | None,
) -> MirrorError:
    return kind(problem, file=file, place=place, expected=expected, remedy=remedy)


class UsageError(MirrorError):
    """A call or a command line is not valid."""


class RecordingError(MirrorError):
    """A recording cannot be used in its present form."""


class SchemaError(MirrorError):
    """A table or a JSON file does not follow its schema, or follows another version of the schema."""


class DatasetError(MirrorError):
    """A dataset is missing, incomplete, locked, stale, or in conflict with the request."""


ANOTHER_PLACE: Final = "choose another place"


class UnwritableError(DatasetError):
    """A file cannot be written where it belongs."""

    def name_option(self, option: str) -> None:
        """Add to the remedy the option that chooses another place."""
        if self.remedy is not None and f"{ANOTHER_PLACE} with" not in self.remedy:
            self.remedy = self.remedy.replace(ANOTHER_PLACE, f"{ANOTHER_PLACE} with {option}")
