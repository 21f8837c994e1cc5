"""Files of JSON lines that grow while a program runs: each line is an object, appended whole.

A last line without its end was cut off by an interruption, or another process is writing it at this moment. Readers
leave it out, and the next `append_line` removes it.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, TypeVar

from mirror.errors import DatasetError
from mirror.schema.files import unwritable_error
from mirror.schema.strict_json import JsonError, decode_json

Row = TypeVar("Row")


def decode_object(line: bytes) -> dict[str, Any]:
    """Decode a line that holds an object.

    Raises:
        JsonError: the line is not JSON, or no object.
    """
    row = decode_json(line)
    if not isinstance(row, dict):
        raise JsonError("no object")
    return row


class LineReader(Generic[Row]):
    """A reader of a file that grows; each call returns the lines that were appended since the last one.

    Args:
        path: the file; it need not exist.
        decode: makes a row of a line, and raises `ValueError` or `KeyError` for a broken one.
    """

    def __init__(self, path: Path, decode: Callable[[bytes], Row]) -> None:
        self._path, self._decode = path, decode
        self._bytes, self._lines = 0, 0

    def read(self) -> list[tuple[int, Row]]:
        """Read the complete new lines; returns the number of each, from 1, and its row.

        Raises:
            DatasetError: the file cannot be read, or a complete line is broken; the error names it.
        """
        try:
            with self._path.open("rb") as file:
                file.seek(self._bytes)
                data = file.read()
        except FileNotFoundError:
            return []
        except OSError as error:
            raise DatasetError(f"cannot be read: {error.strerror or error}", file=self._path) from error
        complete = data[: data.rfind(b"\n") + 1]
        rows = []
        for number, line in enumerate(complete.split(b"\n")[:-1], self._lines + 1):
            try:
                rows.append((number, self._decode(line)))
            except (ValueError, KeyError) as error:
                problem = f"no key {error}" if isinstance(error, KeyError) else str(error).partition("\n")[0]
                raise DatasetError(
                    f"broken ({problem})", file=self._path, place=f"line {number}", expected="one JSON object a line",
                    remedy="delete the line, then run the same command again: what the line recorded is made again",
                ) from error  # fmt: skip
        self._bytes, self._lines = self._bytes + len(complete), self._lines + len(rows)
        return rows


def read_lines(path: Path, decode: Callable[[bytes], Row]) -> list[Row]:
    """Read all complete lines of a file; none if there is no file.

    Args:
        path: the file.
        decode: makes a row of a line, and raises `ValueError` or `KeyError` for a broken one.

    Raises:
        DatasetError: the file cannot be read, or a complete line is broken; the error names it.
    """
    return [row for _, row in LineReader(path, decode).read()]


def append_line(path: Path, text: str, *, sync: bool = False) -> None:
    """Append a line; several processes may append to the same file.

    Args:
        path: the file; it is made if it is missing.
        text: the line without its end.
        sync: whether the line is on disk, and not in the system's memory alone, when this returns.

    Raises:
        DatasetError: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a+b") as file:
            # Closing the file releases the lock.
            fcntl.flock(file, fcntl.LOCK_EX)
            if file.seek(0, os.SEEK_END):
                file.seek(-1, os.SEEK_END)
                if file.read(1) != b"\n":
                    file.seek(0)
                    file.truncate(file.read().rfind(b"\n") + 1)
            file.write(f"{text}\n".encode())
            if sync:
                file.flush()
                os.fsync(file.fileno())
    except OSError as error:
        raise unwritable_error(path, error) from error
