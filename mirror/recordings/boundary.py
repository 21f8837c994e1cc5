"""The boundary to readers, which may come from other packages: a reader's failure is an error of its recording."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import ValidationError

from mirror.errors import MirrorError, RecordingError, UsageError
from mirror.plugins import error_in_plugin
from mirror.schema.problems import describe_problems


@contextmanager
def reader_errors(path: Path) -> Iterator[None]:
    """Turn an unexpected exception of a reader into a `RecordingError` with the original as its cause.

    One bad recording must not end the run of the others, and the exceptions that libraries raise on damaged bytes
    cannot be listed: for the header of an ``.npy`` file alone NumPy raises `ValueError`, `tokenize.TokenError`,
    `MemoryError` and `RecursionError`. A `MirrorError` passes unchanged, except a `UsageError`: it blames the caller,
    but here the recording holds the numbers that make no pose or camera. An error inside a reader of another package or
    file is named with that file and line.

    Args:
        path: the recording.

    Raises:
        RecordingError: in place of any other exception.
    """
    try:
        yield
    except UsageError as error:
        raise RecordingError(
            error.problem,
            file=error.file or path,
            place=error.place,
            expected=error.expected,
            remedy=error.remedy or "correct the recording",
        ) from error
    except MirrorError:
        raise
    except ValidationError as error:
        problem, place = describe_problems(error.errors())
        raise RecordingError(
            problem, file=path, place=f"{error.title}: {place}", remedy="correct the recording, or its reader"
        ) from error
    except Exception as error:
        at = error_in_plugin(error)
        raise RecordingError(
            f"its reader failed ({type(error).__name__}: {error})",
            file=path,
            place=None if at is None else f"{at.file}, {at.place}",
            expected="a recording that follows its reader's documentation",
            remedy="correct the recording; if it is right, "
            + ("report this to the reader's author" if at is None else str(at.remedy)),
        ) from error
