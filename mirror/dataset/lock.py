"""One writer a dataset: an advisory lock that the system releases when its holder dies, however it dies."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager

from mirror.dataset.layout import Layout
from mirror.errors import DatasetError
from mirror.schema.files import unwritable


def is_written(layout: Layout) -> bool:
    """Whether a run holds the dataset's lock now."""
    try:
        with layout.lock.open() as handle:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        # Nobody has ever locked it, or nobody here may.
        return False
    return False


@contextmanager
def writer_lock(layout: Layout, *, wait: bool) -> Iterator[None]:
    """Hold the dataset's lock.

    Args:
        layout: the dataset; its root is made if need be.
        wait: wait for another writer, or refuse at once.

    Raises:
        DatasetError: another writer holds it and ``wait`` is false, or the folder is not writable.
    """
    try:
        layout.root.mkdir(parents=True, exist_ok=True)
        handle = layout.lock.open("a")
    except OSError as error:
        raise unwritable(layout.lock, error) from error
    with handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise DatasetError(
                "another run is writing this dataset",
                file=layout.root,
                remedy="let it finish; verbs that have --wait can wait for it",
            ) from error
        yield
