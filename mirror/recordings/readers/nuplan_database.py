"""Reads rows of a nuPlan log database: SQLite, opened for reading only, and values that the devkit pickled."""

from __future__ import annotations

import io
import pickle
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import numpy as np

from mirror.arrays import Float64
from mirror.errors import RecordingError
from mirror.recordings.paths import not_a_file_error

REMEDY: Final = "download the log's database again"
_MAGIC: Final = b"SQLite format 3\0"
# What a pickled array of numbers needs; nothing else is ever called.
_ARRAY_PARTS: Final = {
    (module, name)
    for module in ("numpy.core.multiarray", "numpy._core.multiarray")
    for name in ("_reconstruct", "scalar")
} | {("numpy", "ndarray"), ("numpy", "dtype")}


def is_database(file: Path) -> bool:
    """Return whether a file begins as SQLite files do."""
    if not file.is_file():
        return False
    with file.open("rb") as opened:
        return opened.read(len(_MAGIC)) == _MAGIC


@contextmanager
def open_database(file: Path) -> Iterator[Database]:
    """Open a database for reading, without writing any file beside it.

    Raises:
        RecordingError: the file is no regular file, or not a database, or damaged.
    """
    if not file.is_file():
        raise not_a_file_error(file)
    try:
        uri = f"file:{quote(str(file.resolve()))}?mode=ro&immutable=1"
        with closing(sqlite3.connect(uri, uri=True, check_same_thread=False)) as connection:
            connection.execute("PRAGMA trusted_schema = OFF")
            connection.execute("PRAGMA cell_size_check = ON")
            connection.text_factory = lambda data: data.decode(errors="replace")
            yield Database(file, connection)
    except (sqlite3.Error, OverflowError, MemoryError) as error:
        raise RecordingError(
            f"cannot be read ({error})", file=file, expected="a database of nuPlan", remedy=REMEDY
        ) from error


class Database:
    """An open log database of nuPlan."""

    def __init__(self, file: Path, connection: sqlite3.Connection) -> None:
        self.file = file
        self._connection = connection

    def rows(
        self, table: str, columns: Sequence[str], *, join: str = "", where: str = "", order: str = ""
    ) -> list[tuple[Any, ...]]:
        """Return the rows of a table.

        Args:
            table: the table.
            columns: its columns, or expressions of joined tables.
            join: further SQL after FROM.
            where: a condition.
            order: an order.

        Raises:
            RecordingError: there is no such table; a view under its name is none.
        """
        kind = self._connection.execute("SELECT type FROM sqlite_master WHERE name = ?", (table,)).fetchone()
        if kind is None or kind[0] != "table":
            raise RecordingError(
                f"no table {table}",
                file=self.file,
                place=f"table {table}",
                expected="a database of nuPlan",
                remedy=REMEDY,
            )
        query = f"SELECT {', '.join(columns)} FROM {table} {join}"
        query += f" WHERE {where}" if where else ""
        query += f" ORDER BY {order}" if order else ""
        return self._connection.execute(query).fetchall()

    def has_tables(self, names: Sequence[str]) -> bool:
        """Return whether all of the given tables exist."""
        found = {row[0] for row in self._connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        return set(names) <= found

    def matrix(self, rows: Sequence[tuple[Any, ...]], table: str, columns: Sequence[str]) -> Float64:
        """Return the numbers (N, K) of rows as float64; null becomes NaN.

        Raises:
            RecordingError: a value is not a number; the row is named.
        """
        try:
            return np.array([[np.nan if v is None else float(v) for v in row] for row in rows], np.float64).reshape(
                -1, len(columns)
            )
        except (TypeError, ValueError, OverflowError) as error:
            raise RecordingError(
                f"a value that is no number ({error})",
                file=self.file,
                place=f"table {table}",
                expected=f"numbers in {', '.join(columns)}",
                remedy=REMEDY,
            ) from error


class _Numbers(pickle.Unpickler):
    """Loads lists, tuples and arrays of numbers; refuses every other class or function."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ARRAY_PARTS:
            raise pickle.UnpicklingError(f"{module}.{name} is not a number")
        return super().find_class(module, name)


def load_numbers(blob: object, shape: tuple[int, ...], *, file: Path, place: str) -> Float64:
    """Return the numbers that the devkit pickled: a list, or an array.

    Args:
        blob: the bytes.
        shape: the shape that they must have.
        file: the database, for the message.
        place: the place of the value.

    Raises:
        RecordingError: they are none, or have another shape; nothing in the bytes is executed.
    """
    try:
        if not isinstance(blob, bytes):
            raise TypeError(f"a value of type {type(blob).__name__}")
        values = np.asarray(_Numbers(io.BytesIO(blob)).load(), np.float64)
    except Exception as error:
        # Damaged pickles raise any exception.
        raise RecordingError(
            f"no pickled numbers ({type(error).__name__}: {error})",
            file=file,
            place=place,
            expected=f"numbers of shape {shape}",
            remedy=REMEDY,
        ) from error
    if values.shape != shape:
        raise RecordingError(
            f"numbers of shape {values.shape}", file=file, place=place, expected=f"shape {shape}", remedy=REMEDY
        )
    return values
