"""The writer lock of a dataset: at most one process writes it at a time.

It is an advisory lock, which the operating system releases when its holder ends in any way. The lock's file exists only
while a process holds the lock, or after such a process was killed.
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
from mirror.schema.links import refuse_links_out

_PAUSES_S: Final = (0.001, 0.01, 0.03, 0.06)


@contextmanager
def writer_lock(layout: Layout, *, wait: bool) -> Iterator[None]:
    """Hold the dataset's writer lock; folders that this call created are removed at the end if still empty.

    Args:
        layout: the dataset; its root is created if missing.
        wait: True: wait for another writer to end; False: raise an error at once.

    Raises:
        DatasetError: another process holds the lock and ``wait`` is false, the folder is not writable, or a link in it
            leads out of it.
    """
    refuse_links_out(layout.root)
    created = [folder for folder in (layout.root, *layout.root.parents) if not folder.exists()]
    with _acquired(layout, wait=wait):
        try:
            yield
        finally:
            # Removed while the lock is held: a waiting process then notices that the file is gone, and creates another.
            layout.lock.unlink(missing_ok=True)
            with suppress(OSError):
                for folder in created:
                    folder.rmdir()


@contextmanager
def replacing(layout: Layout) -> Iterator[None]:
    """Keep other runs from adding to a dataset while this one replaces files; the caller holds the writer lock.

    It waits for the runs that are committing what they made, which takes them seconds.
    """
    with _root_locked(layout, fcntl.LOCK_EX):
        yield


@contextmanager
def adding(layout: Layout) -> Iterator[None]:
    """Keep other runs from replacing files of a dataset while this one adds to it; any number may add at a time."""
    with _root_locked(layout, fcntl.LOCK_SH):
        yield


@contextmanager
def _root_locked(layout: Layout, kind: int) -> Iterator[None]:
    try:
        handle = os.open(layout.root, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise unwritable_error(layout.root, error) from error
    try:
        # A file system without locks has one writer: that is documented.
        with suppress(OSError):
            fcntl.flock(handle, kind)
        yield
    finally:
        os.close(handle)


def _acquired(layout: Layout, *, wait: bool) -> IO[str]:
    while True:
        try:
            layout.root.mkdir(parents=True, exist_ok=True)
            handle = layout.lock.open("a")
        except FileNotFoundError:
            # Another process removed the folder that it had created.
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
            # A run that is just ending holds the lock for a moment more.
            time.sleep(pause_s)
        else:
            return
    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _is_the_lock(layout: Layout, handle: IO[str]) -> bool:
    """Return whether the locked file is still the one at the lock's path."""
    try:
        return os.path.samestat(os.fstat(handle.fileno()), layout.lock.stat())
    except FileNotFoundError:
        return False
