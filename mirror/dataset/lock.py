"""One writer a dataset: an advisory lock that the system releases when its holder dies, however it dies.

The lock's file lies there only while a run holds it, or after one was killed.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO, Final

from mirror.dataset.layout import Layout
from mirror.errors import DatasetError
from mirror.schema.files import unwritable_error

_PAUSES_S: Final = (0.001, 0.01, 0.03, 0.06)


def is_being_written(layout: Layout) -> bool:
    """Whether a run holds the dataset's lock now."""
    try:
        with layout.lock.open() as handle:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        # Nobody holds it, or nobody here may.
        return False
    return False


@contextmanager
def writer_lock(layout: Layout, *, wait: bool) -> Iterator[None]:
    """Hold the dataset's lock. Folders that were made for it, and are still empty at the end, are removed again.

    Args:
        layout: the dataset; its root is made if need be.
        wait: wait for another writer, or refuse at once.

    Raises:
        DatasetError: another writer holds it and ``wait`` is false, or the folder is not writable.
    """
    made = [folder for folder in (layout.root, *layout.root.parents) if not folder.exists()]
    with _acquired(layout, wait=wait):
        try:
            yield
        finally:
            # While it is held: who waits for it sees that the file has gone, and makes another.
            layout.lock.unlink(missing_ok=True)
            with suppress(OSError):
                for folder in made:
                    folder.rmdir()


def _acquired(layout: Layout, *, wait: bool) -> IO[str]:
    while True:
        try:
            layout.root.mkdir(parents=True, exist_ok=True)
            handle = layout.lock.open("a")
        except FileNotFoundError:
            # Another run removed the folder that it had made.
            continue
        except OSError as error:
            raise unwritable_error(layout.lock, error) from error
        try:
            _lock(handle, wait=wait)
            if _is_the_lock(layout, handle):
                return handle
            handle.close()
        except BlockingIOError as error:
            handle.close()
            raise DatasetError(
                "another run is writing this dataset",
                file=layout.root,
                remedy="let it finish; verbs that have --wait can wait for it",
            ) from error
        except BaseException:
            handle.close()
            raise


def _lock(handle: IO[str], *, wait: bool) -> None:
    if wait:
        fcntl.flock(handle, fcntl.LOCK_EX)
        return
    for pause_s in _PAUSES_S:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            # A reader that asks whether the dataset is being written holds it for a moment.
            time.sleep(pause_s)
        else:
            return
    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _is_the_lock(layout: Layout, handle: IO[str]) -> bool:
    """Whether the file that was locked is still the one at the lock's path."""
    try:
        return os.path.samestat(os.fstat(handle.fileno()), layout.lock.stat())
    except FileNotFoundError:
        return False
