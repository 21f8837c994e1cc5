"""The boundary to readers, which may be anybody's: what one of them fails with is an error of its recording."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mirror.errors import RecordingError

# What code meets that takes malformed data for good; anything else is a fault of ours, and ends the run.
_MALFORMED = (ArithmeticError, AttributeError, LookupError, OSError, TypeError, ValueError)


@contextmanager
def reader_errors(path: Path) -> Iterator[None]:
    """Give what a reader did not foresee as a `RecordingError` of the recording, with its cause.

    Args:
        path: the recording.
    """
    try:
        yield
    except _MALFORMED as error:
        raise RecordingError(
            f"its reader failed ({type(error).__name__}: {error})",
            file=path,
            expected="a recording as its reader's documentation says",
            remedy="correct the recording; if it is right, report this to the reader's author",
        ) from error
