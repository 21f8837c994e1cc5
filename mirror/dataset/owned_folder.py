"""Work folders that belong to one process, and the removal of work folders that a dead process left.

A process works in a folder with a unique name and holds a lock on it. It renames a complete result to its final place.
So a process can remove its own work at any time and never removes the work of another. The next process removes an
abandoned folder once its owner is known to be dead: the folder's name has the boot id of this machine, and its lock is
free. Other folders are removed when nothing in them has changed for `LEFT_OVER_AGE_S`.
"""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import time
import weakref
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final

from mirror.schema.files import unwritable_error

LEFT_OVER_AGE_S: Final = 24 * 3600
"""Age after which an abandoned folder of another machine is removed: one day without a change."""

UNKNOWN: Final = "unknown"


class OwnedFolder:
    """A new folder that is locked until this object is released or garbage collected.

    Args:
        parent: folder in which it is created; created if missing.
        name: first part of the folder's name; the rest is the boot id and a random part.

    Attributes:
        path: the folder.

    Raises:
        DatasetError: the folder cannot be created.
    """

    def __init__(self, parent: Path, name: str) -> None:
        while True:
            self.path = parent / f"{name}.{boot_id()}.{secrets.token_hex(6)}"
            try:
                self.path.mkdir(parents=True)
                handle = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
            except FileNotFoundError:
                continue
            except OSError as error:
                raise unwritable_error(self.path, error) from error
            # Before it was locked, its owner seemed dead: another process may have removed it.
            if _lock(handle) is not False and self.path.exists():
                self._close = weakref.finalize(self, os.close, handle)
                return
            os.close(handle)

    def release(self) -> None:
        """Release the lock and leave the folder to the next process."""
        self._close()

    def remove(self) -> None:
        """Remove the folder and its contents."""
        shutil.rmtree(self.path, ignore_errors=True)
        self._close()


def abandoned_folders(parent: Path, name: str) -> Iterator[Path]:
    """Yield folders of `OwnedFolder` with a dead owner, or unchanged for `LEFT_OVER_AGE_S`.

    The caller removes each of them.

    Args:
        parent: the folder that holds them.
        name: first part of their names.
    """
    for folder in sorted(parent.glob(f"{name}.*.*")):
        try:
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except OSError:
            continue
        try:
            is_free = _lock(handle)
            # A lock of another machine is not visible here: for its folders a free lock proves nothing.
            is_dead = is_free and folder.name.split(".")[-2] == boot_id() != UNKNOWN
            if is_dead or (is_free is not False and _unchanged_s(folder) > LEFT_OVER_AGE_S):
                yield folder
        finally:
            os.close(handle)


def _lock(handle: int) -> bool | None:
    """Lock an open folder. True: locked; False: another process holds the lock; None: the file system has no locks."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _unchanged_s(folder: Path) -> float:
    """Seconds since the last change of a folder or a file in it."""
    newest = 0.0
    for root, _, names in os.walk(folder):
        for path in (root, *(os.path.join(root, name) for name in names)):  # noqa: PTH118 - many files
            with suppress(OSError):
                newest = max(newest, os.lstat(path).st_ctime)
    return time.time() - newest


@cache
def boot_id() -> str:
    """Return an id of this boot of this machine; `UNKNOWN` where the system has none."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip().replace("-", "")[:12]
    except OSError:
        return UNKNOWN
