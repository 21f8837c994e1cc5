"""Rows of one table from many files, as numpy columns with the file and position of each row."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property

import numpy as np
import pyarrow as pa

from mirror.arrays import Bool, Float64, Int64
from mirror.dataset.query.arrow import floats_or_nan, integers_or_zero, is_valid
from mirror.integrity.finding import Finding
from mirror.schema.tables import Table

TablePart = tuple[str, int, pa.Table]
"""A file, relative to the dataset's root; the number of its traversal; its rows."""


class TableRows:
    """The N rows of the files of one table, concatenated.

    Args:
        table: specification of the table.
        parts: the files with their rows.

    Attributes:
        parts: the files with their rows.
        files: names of the files.
        owner: (N,) number of each row's file.
        traversal: (N,) number of each row's traversal.
        row: (N,) position in the file.
    """

    def __init__(self, table: Table, parts: Sequence[TablePart]) -> None:
        self.table = table
        self.parts = parts
        self.files = [file for file, _, _ in parts]
        counts = [data.num_rows for _, _, data in parts]
        self.starts = np.cumsum([0, *counts], dtype=np.int64)
        self.owner = np.repeat(np.arange(len(parts), dtype=np.int64), counts)
        self.traversal = np.repeat(np.array([number for _, number, _ in parts], np.int64), counts)
        self.row = np.arange(self.starts[-1], dtype=np.int64) - self.starts[:-1][self.owner]
        empty = table.schema.empty_table()
        self.data = pa.concat_tables([data for _, _, data in parts]) if parts else empty
        self._floats: dict[str, Float64] = {}
        self._integers: dict[str, Int64] = {}
        self._words: dict[str, tuple[Int64, list[str]]] = {}

    def __len__(self) -> int:
        return len(self.owner)

    def floats(self, name: str) -> Float64:
        """Return a column of floats (N,), NaN where null."""
        if name not in self._floats:
            self._floats[name] = floats_or_nan(self.data.column(name))
        return self._floats[name]

    def integers(self, name: str) -> Int64:
        """Return a column of integers (N,), 0 where null."""
        if name not in self._integers:
            self._integers[name] = integers_or_zero(self.data.column(name)).astype(np.int64, copy=False)
        return self._integers[name]

    def is_known(self, name: str) -> Bool:
        """Mark the rows (N,) in which a column is not null."""
        return is_valid(self.data.column(name))

    def text_codes(self, name: str) -> tuple[Int64, list[str]]:
        """Return the codes (N,) of a column of strings, -1 where null, and the sorted strings that the codes index."""
        if name not in self._words:
            column = self.data.column(name)
            if not pa.types.is_dictionary(column.type):
                column = column.dictionary_encode()
            column = column.unify_dictionaries().combine_chunks()
            if isinstance(column, pa.ChunkedArray):
                column = pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], column.type)
            listed = column.dictionary.to_pylist()
            order = sorted(range(len(listed)), key=lambda index: listed[index])
            place = np.empty(len(listed) + 1, np.int64)
            place[order] = np.arange(len(listed))
            place[-1] = -1
            codes = np.where(is_valid(column.indices), integers_or_zero(column.indices), len(listed))
            self._words[name] = place[codes], [listed[index] for index in order]
        return self._words[name]

    def text(self, name: str, row: int) -> str | None:
        """Return one value of a column of strings."""
        value: str | None = self.data.column(name)[row].as_py()
        return value

    @cached_property
    def same_file(self) -> Bool:
        """Mask (N,) of the rows whose previous row is in the same file."""
        return np.concatenate([[False], self.owner[1:] == self.owner[:-1]]) if len(self) else np.empty(0, np.bool_)

    def same_group(self, *names: str) -> Bool:
        """Mark the rows (N,) whose previous row is in the same file and has the same strings in some columns."""
        same = self.same_file.copy()
        for name in names:
            codes = self.text_codes(name)[0]
            same[1:] &= codes[1:] == codes[:-1]
        return same

    def runs(self, *names: str) -> Int64:
        """Return the bounds (R + 1,) of the R runs of rows that `same_group` joins."""
        return np.append(np.flatnonzero(~self.same_group(*names)), len(self)).astype(np.int64)

    def slices(self) -> Iterator[tuple[str, int, slice]]:
        """Yield each file, the number of its traversal, and its rows."""
        bounds = self.starts.tolist()
        for (file, number, _), start, stop in zip(self.parts, bounds[:-1], bounds[1:]):
            yield file, number, slice(start, stop)

    def key_columns(self) -> list[tuple[Int64, Bool]]:
        """Return the sort columns of the table as integers (N,) of the same order, and masks (N,) of their values."""
        columns = []
        for name in self.table.sorted_by:
            whole = pa.types.is_integer(self.table.schema.field(name).type)
            columns.append((self.integers(name) if whole else self.text_codes(name)[0], self.is_known(name)))
        return columns

    def place(self, row: int) -> str:
        """Return the number and keys of a row, for a message."""
        keys = [name for name in self.table.sorted_by if self.data.column(name)[row].is_valid]
        return ", ".join([f"row {self.row[row]}", *(f"{name} {self.data.column(name)[row].as_py()}" for name in keys)])

    def findings(self, bad: Bool, message: Callable[[int], str], *, worst: Float64 | None = None) -> Iterator[Finding]:
        """Yield a finding for each file with bad rows, with the first or worst row and the number of bad rows.

        Args:
            bad: (N,) mask of the bad rows.
            message: describes the fault of a row.
            worst: (N,) size of the fault, to name the worst row; None: the first row is named.
        """
        hits = np.flatnonzero(bad)
        owners, first, counts = np.unique(self.owner[hits], return_index=True, return_counts=True)
        for owner, begin, count in zip(owners.tolist(), first.tolist(), counts.tolist()):
            own = hits[begin : begin + count]
            row = int(own[0] if worst is None else own[np.argmax(worst[own])])
            yield Finding(self.files[owner], self.place(row), message(row), count)
