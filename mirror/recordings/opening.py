"""Opening a recording's files: plain files inside it alone, never a pipe or device, never what a link leads out to.

Every reader takes its files from here or from the listings of `mirror.recordings.paths`, which check the same.
"""

from __future__ import annotations

import os
import stat
import sys
import tokenize
from pathlib import Path
from typing import Any

import numpy as np

from mirror.arrays import Float64
from mirror.errors import RecordingError
from mirror.recordings.paths import not_a_file_error, require_inside
from mirror.schema.strict_json import JsonError, decode_json

# What NumPy raises on the header of a damaged ``.npy`` file.
_BROKEN_ARRAY = (
    OSError,
    ValueError,
    EOFError,
    SyntaxError,
    ArithmeticError,
    MemoryError,
    RecursionError,
    tokenize.TokenError,
)


def find_file(root: Path, name: str) -> Path | None:
    """The plain file of a name inside a recording; None: there is nothing of that name.

    Args:
        root: the recording's folder.
        name: a relative path with forward slashes.

    Raises:
        RecordingError: it is a link that leads out or to nothing, or no plain file (a folder, pipe or device).
    """
    path = require_inside(root, name, file=root / name, place="link")
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError) as error:
        if path.is_symlink():
            raise unreadable_error(path, error) from error
        return None
    except OSError as error:
        raise unreadable_error(path, error) from error
    if not stat.S_ISREG(mode):
        raise not_a_file_error(path)
    return path


def require_file(root: Path, name: str) -> Path:
    """As `find_file`, of a file that must be there.

    Raises:
        RecordingError: there is no such file, or as in `find_file`.
    """
    path = find_file(root, name)
    if path is None:
        raise unreadable_error(root / name, FileNotFoundError())
    return path


def read_file(file: str | Path) -> bytes:
    """All bytes of a plain file; a pipe is not waited for, and a device is not read.

    Raises:
        RecordingError: it is missing, unreadable or no plain file.
    """
    return read_file_start(file, sys.maxsize)[0]


def read_file_start(file: str | Path, count: int) -> tuple[bytes, int]:
    """The first bytes of a plain file, and its size; see `read_file`.

    Args:
        file: the file.
        count: how many bytes at most.

    Raises:
        RecordingError: it is missing, unreadable or no plain file.
    """
    try:
        descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK)
    except OSError as error:
        raise unreadable_error(Path(file), error) from error
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise not_a_file_error(Path(file))
        wanted = min(count, status.st_size)
        data = os.read(descriptor, wanted)
        while len(data) < wanted and (more := os.read(descriptor, wanted - len(data))):
            data += more
        return data, status.st_size
    except OSError as error:
        raise unreadable_error(Path(file), error) from error
    finally:
        os.close(descriptor)


def read_json(file: Path) -> Any:
    """A JSON document.

    Raises:
        RecordingError: it is missing or no JSON: line and column, or the key, are named.
    """
    data = read_file(file)
    try:
        return decode_json(data)
    except JsonError as error:
        raise RecordingError(
            str(error),
            file=file,
            place=error.place,
            remedy="correct it, or copy the file again: a truncated file ends before its last bracket",
        ) from error


def read_array(file: Path) -> Float64:
    """A NumPy file of numbers, as float64; it never takes more memory than the file has bytes for.

    Raises:
        RecordingError: it is missing, broken, shorter than its header claims, or holds something else than numbers.
    """
    try:
        # A mapping is refused where the header claims more than there is, before memory is asked for.
        array = np.load(file, mmap_mode="r", allow_pickle=False)
    except _BROKEN_ARRAY as error:
        raise unreadable_error(file, error) from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        kind = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise RecordingError(f"an array of {kind}", file=file, expected="a NumPy file of real numbers")
    return np.array(array, np.float64)


def unreadable_error(file: Path, error: Exception) -> RecordingError:
    """The error for a file that is missing, truncated or of another kind."""
    kind = "a complete Parquet file" if file.suffix == ".parquet" else "a readable, complete file"
    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    missing = isinstance(error, FileNotFoundError)
    return RecordingError(
        "missing" if missing else f"cannot be read ({reason})",
        file=file,
        expected=kind,
        remedy="copy the file again from the vehicle or archive",
    )
