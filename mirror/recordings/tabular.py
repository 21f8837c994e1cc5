"""Tables of a recording, read from CSV or Parquet in one or many files as one, each row still knowing its file."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import RecordingError
from mirror.recordings.time import StampError, to_unix_ns


@dataclass(frozen=True)
class Rows:
    """A table that was read from files in sequence.

    Attributes:
        table: all rows.
        files: the files, in order.
        starts: the row at which each file starts.
    """

    table: pa.Table
    files: tuple[Path, ...]
    starts: tuple[int, ...]

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def __contains__(self, column: str) -> bool:
        return column in self.table.column_names

    def locate(self, row: int) -> tuple[Path, str]:
        """The file of a row, and where in it: a line of a CSV file (the header is line 1), a row of Parquet."""
        index = bisect_right(self.starts, row) - 1
        file, within = self.files[index], row - self.starts[index]
        return file, f"row {within}" if file.suffix == ".parquet" else f"line {within + 2}"

    def error(self, row: int, column: str, problem: str, *, expected: str, remedy: str) -> RecordingError:
        """The error for one value."""
        file, place = self.locate(row)
        return RecordingError(problem, file=file, place=f"{place}, column {column}", expected=expected, remedy=remedy)

    def refuse(self, bad: Bool, column: str, problem: str, *, expected: str, remedy: str) -> None:
        """Raise for the first bad row.

        Raises:
            RecordingError: a row is bad.
        """
        if bad.any():
            raise self.error(int(np.argmax(bad)), column, problem, expected=expected, remedy=remedy)

    def floats(self, column: str) -> Float64:
        """A column as float64 (N,); missing values are NaN.

        Raises:
            RecordingError: there is no such column, or it holds no numbers.
        """
        values = self.column(column)
        try:
            return np.array(values.cast(pa.float64()), dtype=np.float64)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
            raise RecordingError(
                f"no column of numbers ({error})", file=self.files[0], place=f"column {column}", expected="numbers"
            ) from error

    def stamps(self, column: str, base: str) -> Int64:
        """A column of numbers in a time base, as Unix nanoseconds (N,).

        Raises:
            RecordingError: there is no such column, or a value is no stamp of that base.
        """
        try:
            return to_unix_ns(self.column(column), base)
        except StampError as error:
            raise self.error(
                error.row,
                column,
                error.problem,
                expected=f"a number in the time base {base}",
                remedy="correct the value, or the time base that the recording declares",
            ) from error

    def column(self, name: str) -> pa.ChunkedArray:
        """A column as read.

        Raises:
            RecordingError: there is no such column.
        """
        if name not in self:
            raise RecordingError(
                "the column is missing",
                file=self.files[0],
                place=f"column {name}",
                expected=f"{name} beside {', '.join(self.table.column_names)}",
            )
        return self.table.column(name)


def read_rows(
    files: Sequence[Path],
    *,
    types: Mapping[str, pa.DataType],
    columns: Sequence[str] | None = None,
    delimiter: str = ",",
) -> Rows:
    """Read files of one kind as one table.

    Args:
        files: CSV or Parquet (``.parquet``), in order; all with the same columns.
        types: how to read columns of a CSV file, where not by their looks.
        columns: only these; all of them must be there.
        delimiter: of CSV files.

    Raises:
        RecordingError: a file is missing, broken or empty, or its columns are not those of the first.
    """
    tables: list[pa.Table] = []
    for file in files:
        table = _read(file, types, columns, delimiter)
        if tables and table.column_names != tables[0].column_names:
            odd = sorted(set(table.column_names) ^ set(tables[0].column_names)) or table.column_names
            raise RecordingError(
                f"other columns than {files[0].name}: {', '.join(odd)}",
                file=file,
                expected=f"the columns {', '.join(tables[0].column_names)} in every file of the drive",
            )
        tables.append(table)
    lengths = [table.num_rows for table in tables]
    if not sum(lengths):
        raise RecordingError("no rows", file=files[0], expected="at least one row", remedy="leave the recording out")
    starts = np.concatenate(([0], np.cumsum(lengths)[:-1]))
    # Two files may look like whole numbers here and like decimals there.
    table = pa.concat_tables(tables, promote_options="permissive")
    return Rows(table, tuple(files), tuple(int(start) for start in starts))


def header(file: Path, delimiter: str | None = None) -> tuple[list[str], str]:
    """The column names of a CSV file and its delimiter: the given one, or that of ``, ; tab |`` which splits it most.

    Raises:
        RecordingError: the file is missing or empty.
    """
    try:
        with file.open(encoding="utf-8-sig", errors="replace") as lines:
            first = lines.readline().rstrip("\r\n")
    except OSError as error:
        raise unreadable(file, error) from error
    if not first:
        raise RecordingError("empty", file=file, expected="a header line with the names of the columns")
    used = delimiter or max(",;\t|", key=first.count)
    return [name.strip().strip('"') for name in first.split(used)], used


def unreadable(file: Path, error: Exception) -> RecordingError:
    """The error for a file that is missing, truncated or of another kind."""
    kind = "a complete Parquet file" if file.suffix == ".parquet" else "a readable, complete file"
    reason = "missing" if isinstance(error, FileNotFoundError) else f"cannot be read ({str(error).splitlines()[0]})"
    return RecordingError(reason, file=file, expected=kind, remedy="copy the file again from the vehicle or archive")


def _read(file: Path, types: Mapping[str, pa.DataType], columns: Sequence[str] | None, delimiter: str) -> pa.Table:
    try:
        if file.suffix == ".parquet":
            import pyarrow.parquet as pq

            table = pq.ParquetFile(file).read(use_threads=False)
        else:
            table = _read_csv(file, types, delimiter)
    except (pa.ArrowInvalid, OSError) as error:
        raise unreadable(file, error) from error
    if columns is None:
        return table
    absent = [name for name in columns if name not in table.column_names]
    if absent:
        raise RecordingError(
            "the column is missing",
            file=file,
            place=f"column {absent[0]}",
            expected=f"one of {', '.join(table.column_names)}",
        )
    return table.select(list(columns))


def _read_csv(file: Path, types: Mapping[str, pa.DataType], delimiter: str) -> pa.Table:
    from pyarrow import csv

    parse = csv.ParseOptions(delimiter=delimiter)
    convert = csv.ConvertOptions(column_types=dict(types), strings_can_be_null=True)
    names = [name.strip() for name in header(file, delimiter)[0]]
    reading = {"column_names": names, "skip_rows": 1}
    try:
        return csv.read_csv(file, read_options=csv.ReadOptions(**reading), parse_options=parse, convert_options=convert)
    except pa.ArrowInvalid:
        # Only one thread counts rows: read again for an error that names the line.
        return csv.read_csv(
            file,
            read_options=csv.ReadOptions(use_threads=False, **reading),
            parse_options=parse,
            convert_options=convert,
        )
