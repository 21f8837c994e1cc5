"""The boundary to readers, which may be anybody's: what one of them fails with is an error of its recording."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mirror.errors import MirrorError, RecordingError, UsageError


@contextmanager
def reader_errors(path: Path) -> Iterator[None]:
    """Give whatever a reader did not foresee as a `RecordingError` of the recording, with its cause.

    One bad recording never ends the run of the others, and what a library raises on damaged bytes belongs to no list:
    NumPy's header of an ``.npy`` file alone gives `ValueError`, `tokenize.TokenError`, `MemoryError` and
    `RecursionError`. A `MirrorError` passes as it is, but for a `UsageError`, which blames a call: numbers of a
    recording that make no pose or camera are the recording's.

    Args:
        path: the recording.

    Raises:
        RecordingError: instead of any other exception.
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
    except Exception as error:
        raise RecordingError(
            f"its reader failed ({type(error).__name__}: {error})",
            file=path,
            expected="a recording as its reader's documentation says",
            remedy="correct the recording; if it is right, report this to the reader's author",
        ) from error
