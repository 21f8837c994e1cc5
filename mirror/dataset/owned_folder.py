"""Folders that one attempt alone writes, and when what a dead attempt left may be removed.

An attempt never writes where another may: it works in a folder whose name nobody else uses, holds a lock on it, and
renames what is complete to its place. So it can remove its own work at any time, and never that of another. What an
attempt left is removed by whoever comes next, once its owner is known to be dead (it ran under this boot of this
machine, and its lock is free), else once nothing in it has changed for `LEFT_OVER_AGE_S`.
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
"""What an attempt on another machine left is removed after a day without a change."""


_UNKNOWN: Final = "unknown"


class OwnedFolder:
    """A new folder, locked for as long as this object lives or until it is released.

    Args:
        parent: where it is made; made itself if need be.
        name: how its name begins; the rest is random.

    Attributes:
        path: the folder.

    Raises:
        DatasetError: it cannot be made.
    """

    def __init__(self, parent: Path, name: str) -> None:
        while True:
            self.path = parent / f"{name}.{_boot()}.{secrets.token_hex(6)}"
            try:
                self.path.mkdir(parents=True)
                handle = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
            except FileNotFoundError:
                continue
            except OSError as error:
                raise unwritable_error(self.path, error) from error
            # Until it was locked it looked as if its owner were dead: another run may have removed it.
            if _lock(handle) is not False and self.path.exists():
                self._close = weakref.finalize(self, os.close, handle)
                return
            os.close(handle)

    def release(self) -> None:
        """Leave the folder to whoever comes next."""
        self._close()

    def remove(self) -> None:
        """Remove the folder with all that is in it."""
        shutil.rmtree(self.path, ignore_errors=True)
        self._close()


def abandoned_folders(parent: Path, name: str) -> Iterator[Path]:
    """Folders of `OwnedFolder` whose owner is dead or silent for `LEFT_OVER_AGE_S`; the caller removes each of them."""
    for folder in sorted(parent.glob(f"{name}.*.*")):
        try:
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except OSError:
            continue
        try:
            free = _lock(handle)
            # A lock is not seen on other machines, so that a free one says nothing of their folders.
            dead = free and folder.name.split(".")[-2] == _boot() != _UNKNOWN
            if dead or (free is not False and _silent_s(folder) > LEFT_OVER_AGE_S):
                yield folder
        finally:
            os.close(handle)


def _lock(handle: int) -> bool | None:
    """Lock an open folder: True; False: another holds the lock; None: this file system has no locks for folders."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _silent_s(folder: Path) -> float:
    """Seconds since anything in a folder was changed."""
    newest = 0.0
    for root, _, names in os.walk(folder):
        for path in (root, *(os.path.join(root, name) for name in names)):  # noqa: PTH118 - many files
            with suppress(OSError):
                newest = max(newest, os.lstat(path).st_ctime)
    return time.time() - newest


@cache
def _boot() -> str:
    """What tells this boot of this machine from others; `_UNKNOWN` where the system does not say."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip().replace("-", "")[:12]
    except OSError:
        return _UNKNOWN
