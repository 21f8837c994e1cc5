"""Commits of files that are written once: a name gets its bytes from the first writer, and never other bytes.

A file is complete before it gets its name, by a hard link, which fails where the name is taken. Two writers of equal
bytes are both done; a writer of other bytes gets an error that names both. No file is opened for writing at its name,
renamed away or removed, so that a writer that wakes late changes nothing of what another one committed.
"""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from mirror.errors import DatasetError
from mirror.schema.files import temporary_path, unwritable_error

_NO_LINKS: Final = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EXDEV, errno.EMLINK, errno.ENOSYS)
_PIECE: Final = 1 << 20
_REMEDY: Final = (
    "let the other run end. If none is running, an interrupted one of other input or options left it: "
    "`mirror ingest` with --replace replaces it"
)


class ConflictError(DatasetError):
    """A name that is to get its bytes for good has other bytes."""


def commit_bytes(path: Path, data: bytes) -> bool:
    """Create a file with its bytes, unless it exists with the same bytes.

    Args:
        path: the file; its folder is made if missing.
        data: its bytes.

    Returns:
        True: this call created it; False: it was there.

    Raises:
        ConflictError: it exists with other bytes.
        UnwritableError: it cannot be written.
    """
    temporary = temporary_path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(data)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise unwritable_error(path, error) from error
    try:
        return commit_file(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def commit_file(source: Path, path: Path) -> bool:
    """Give a complete file its final name, unless that exists with the same bytes; the source stays.

    A file system without hard links gets a copy, which is created exclusively. A copy that was cut off by a kill is in
    conflict with the next attempt, which names it.

    Args:
        source: the complete file, on the same file system where possible.
        path: the final name; its folder is made if missing.

    Returns:
        True: this call created it; False: it was there.

    Raises:
        ConflictError: it exists with other bytes.
        UnwritableError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(source, path)
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            _copy(source, path)
    except FileExistsError as error:
        if path.is_dir() or not path.exists():
            raise unwritable_error(path, error) from error
        _require_equal(source, path)
        return False
    except OSError as error:
        raise unwritable_error(path, error) from error
    return True


def commit_folder(source: Path, folder: Path, last: str) -> None:
    """Commit every file of a complete folder, the one that makes the folder complete at the end.

    Args:
        source: the complete folder; it stays.
        folder: where its files get their final names.
        last: path of that file, relative to the folder.

    Raises:
        ConflictError: a file exists with other bytes.
        UnwritableError: a file cannot be written.
    """
    for name in sorted(files_below(source)):
        if name != last:
            commit_file(source / name, folder / name)
    commit_file(source / last, folder / last)


def conflict_error(file: str | Path, mine: str, theirs: str, remedy: str) -> ConflictError:
    """Make the error for a name that has other bytes; it names both by their SHA-256 in hexadecimal."""
    return ConflictError(
        f"the file is there with other bytes, of SHA-256 {theirs}",
        file=file,
        expected=f"the bytes that this run made, of SHA-256 {mine}",
        remedy=remedy,
    )


def files_below(folder: Path) -> Iterator[str]:
    """Yield the paths of all files of a folder, relative to it, with ``/``."""
    for at, _, names in os.walk(folder):
        below = Path(at).relative_to(folder)
        yield from ((below / name).as_posix() for name in names)


def _copy(source: Path, path: Path) -> None:
    with source.open("rb") as reader, path.open("xb") as writer:
        try:
            shutil.copyfileobj(reader, writer, _PIECE)
            writer.flush()
            os.fsync(writer.fileno())
        except BaseException:
            path.unlink(missing_ok=True)
            raise


def _require_equal(source: Path, path: Path) -> None:
    if source.samefile(path):
        return
    mine, theirs = _sha256(source), _sha256(path)
    if mine != theirs:
        raise conflict_error(path, mine, theirs, _REMEDY)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
