"""Opens the files of a recording: only regular files inside it, no pipes or devices, and no links that lead outside.

Every reader opens its files with these functions or takes them from the listings of `mirror.recordings.paths`, which
apply the same checks.
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

# The exceptions that NumPy raises on the header of a damaged ``.npy`` file.
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
    """Find a regular file of a recording by its name; None if it does not exist.

    Args:
        root: the recording's folder.
        name: a relative path with forward slashes.

    Raises:
        RecordingError: it is a link that leads outside or to nothing, or is not a regular file but a folder, pipe or
            device.
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
    """Find a regular file of a recording that must exist; see `find_file`.

    Raises:
        RecordingError: the file does not exist, or `find_file` refuses it.
    """
    path = find_file(root, name)
    if path is None:
        raise unreadable_error(root / name, FileNotFoundError())
    return path


def read_file(file: str | Path) -> bytes:
    """Read all bytes of a regular file; pipes and devices are refused without waiting.

    Raises:
        RecordingError: the file is missing, unreadable or not a regular file.
    """
    return read_file_start(file, sys.maxsize)[0]


def read_file_start(file: str | Path, count: int) -> tuple[bytes, int]:
    """Read the first bytes of a regular file; see `read_file`.

    Args:
        file: the file.
        count: the largest number of bytes to read.

    Returns:
        The bytes, and the size of the whole file.

    Raises:
        RecordingError: the file is missing, unreadable or not a regular file.
    """
    try:
        descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK)
    except OSError as error:
        raise unreadable_error(Path(file), error) from error
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise not_a_file_error(Path(file))
        length = min(count, status.st_size)
        data = os.read(descriptor, length)
        while len(data) < length and (more := os.read(descriptor, length - len(data))):
            data += more
        return data, status.st_size
    except OSError as error:
        raise unreadable_error(Path(file), error) from error
    finally:
        os.close(descriptor)


def read_json(file: Path) -> Any:
    """Read a JSON document.

    Raises:
        RecordingError: the file is missing or is not JSON; line and column, or the key, are named.
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
    """Read a NumPy file of real numbers as float64, without trusting its header for more bytes than the file has.

    Raises:
        RecordingError: the file is missing, broken or shorter than its header claims, or does not hold real numbers.
    """
    try:
        # Mapping fails before any memory is allocated if the header claims more bytes than the file has.
        array = np.load(file, mmap_mode="r", allow_pickle=False)
    except _BROKEN_ARRAY as error:
        raise unreadable_error(file, error) from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        kind = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise RecordingError(f"an array of {kind}", file=file, expected="a NumPy file of real numbers")
    return np.array(array, np.float64)


def unreadable_error(file: Path, error: Exception) -> RecordingError:
    """Make the error for a file that is missing, truncated or of another format."""
    kind = "a complete Parquet file" if file.suffix == ".parquet" else "a readable, complete file"
    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    missing = isinstance(error, FileNotFoundError)
    return RecordingError(
        "missing" if missing else f"cannot be read ({reason})",
        file=file,
        expected=kind,
        remedy="copy the file again from the vehicle or archive",
    )
