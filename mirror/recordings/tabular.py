"""Reads tables of a recording from one or several CSV or Parquet files as one table that knows the file of each row."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Bool, Float64, Int64
from mirror.counting import count_of
from mirror.errors import RecordingError
from mirror.recordings.bad_rows import Reason
from mirror.recordings.opening import unreadable_error
from mirror.recordings.protocol import Track
from mirror.recordings.row_faults import RowFaults
from mirror.recordings.time import StampError, to_unix_ns
from mirror.schema.parquet_memory import read_distinct_rows, require_memory

# Measured at ingest of 20 million poses: 225 bytes a row of 40.
_COPIES: Final = 6.0


@dataclass(frozen=True)
class RecordingRows:
    """A table that was read from files in sequence.

    Attributes:
        table: all rows.
        files: the files, in order.
        starts: the first row of each file.
        torn: by file, the lines that are left out because they have too few or too many cells.
        faults: marks bad rows; None: the first bad row is an error.
        numbers: by file, (N,) the row of the file of each row; None: all rows of the file are in the table.
    """

    table: pa.Table
    files: tuple[Path, ...]
    starts: tuple[int, ...]
    torn: tuple[tuple[int, ...], ...] = ()
    faults: RowFaults | None = None
    numbers: tuple[Int64 | None, ...] = ()

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def __contains__(self, column: str) -> bool:
        return column in self.table.column_names

    def locate(self, row: int) -> tuple[Path, str]:
        """Locate a row: its file, and its line in a CSV file (the header is line 1) or its row in Parquet."""
        index = bisect_right(self.starts, row) - 1
        file, within = self.files[index], row - self.starts[index]
        if file.suffix == ".parquet":
            numbers = self.numbers[index] if self.numbers else None
            return file, f"row {within if numbers is None else numbers[within]}"
        line = within + 2
        for torn in self.torn[index] if self.torn else ():
            line += torn <= line
        return file, f"line {line}"

    def error(self, row: int, column: str, problem: str, *, expected: str, remedy: str) -> RecordingError:
        """Make the error for one value."""
        file, place = self.locate(row)
        return RecordingError(problem, file=file, place=f"{place}, column {column}", expected=expected, remedy=remedy)

    def refuse(
        self,
        bad: Bool,
        column: str,
        problem: str | Callable[[int], str],
        *,
        expected: str,
        remedy: str,
        reason: Reason = "number",
    ) -> None:
        """Mark bad rows; raise an error for the first bad row if the table needs every row.

        Args:
            bad: (N,) True where a row is bad.
            column: the column of the wrong values.
            problem: what is wrong, or a function from a row to what is wrong with it.
            expected: what a right value is.
            remedy: what the user can do.
            reason: the reason by which the rows are counted.

        Raises:
            RecordingError: a row is bad, and the table needs every row.
        """

        def error(row: int) -> RecordingError:
            text = problem if isinstance(problem, str) else problem(row)
            return self.error(row, column, text, expected=expected, remedy=remedy)

        if self.faults is not None:
            self.faults.add(bad, reason, error)
        elif bad.any():
            raise error(int(np.argmax(bad)))

    def floats(self, column: str) -> Float64:
        """Read a column as float64 (N,); missing values and values of marked rows are NaN.

        Raises:
            RecordingError: the column does not exist, or a value is not a number and the table needs every row.
        """
        values = self.column(column)
        try:
            return np.array(values.cast(pa.float64()), dtype=np.float64)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
            if self.faults is None or not pa.types.is_string(values.type):
                raise RecordingError(
                    f"not a column of numbers ({error})",
                    file=self.files[0],
                    place=f"column {column}",
                    expected="numbers",
                ) from error
        text = values.to_pylist()
        numbers = np.array([_number(cell) for cell in text])
        bad = np.isnan(numbers) & np.array([cell is not None and cell.strip().lower() != "nan" for cell in text])
        self.refuse(
            bad,
            column,
            lambda row: f"{text[row]!r:.80} is not a number",
            expected="a number, or an empty cell",
            remedy="correct or remove the row",
        )
        return numbers

    def sigmas(self, column: str) -> Float64:
        """Read a column of standard deviations (N,); missing values are NaN.

        Raises:
            RecordingError: as in `floats`; or a value is negative or infinite and the table needs every row.
        """
        sigma = self.floats(column)
        self.refuse(
            (sigma < 0) | np.isinf(sigma),
            column,
            lambda row: f"{sigma[row]} is not a standard deviation",
            expected="metres, or an empty cell",
            remedy="correct or remove the row",
            reason="sigma",
        )
        return sigma

    def stamps(self, column: str, base: str) -> Int64:
        """Read a column of numbers in a time base as Unix nanoseconds (N,); marked rows have any value.

        Raises:
            RecordingError: the column does not exist, or a value is not a stamp of that time base and the table needs
                every row.
        """
        values = self.column(column)
        marked = np.zeros(len(self), np.bool_)
        while True:
            try:
                return to_unix_ns(values, base)
            except StampError as error:
                self.refuse(
                    error.bad,
                    column,
                    error.problem,
                    expected=f"a number in the time base {base}",
                    remedy="correct the value, or the time base that the recording declares",
                    reason="time",
                )
                marked |= error.bad
                if marked.all():
                    return np.zeros(len(self), np.int64)
                values = pc.if_else(pa.array(~marked), values, values[int(np.argmin(marked))])

    @property
    def good(self) -> Bool:
        """(N,) True where a row is not marked as bad."""
        return np.ones(len(self), np.bool_) if self.faults is None else self.faults.good

    def without_bad(self, track: Track) -> Track:
        """Remove the rows that are marked as bad from a track with one pose per row."""
        return track if self.faults is None else self.faults.drop_from(track)

    def column(self, name: str) -> pa.ChunkedArray:
        """Return the column as read.

        Raises:
            RecordingError: the column does not exist.
        """
        self.require_columns((name,))
        return self.table.column(name)

    def require_columns(self, names: Sequence[str]) -> None:
        """Refuse a table that lacks columns.

        Raises:
            RecordingError: some do not exist; all of them are named.
        """
        _require_columns(names, self.table.column_names, self.files[0])


def read_rows(
    files: Sequence[Path],
    *,
    types: Mapping[str, pa.DataType],
    columns: Sequence[str] | None = None,
    delimiter: str = ",",
    tolerant: bool = False,
) -> RecordingRows:
    """Read files of one format as one table.

    Args:
        files: CSV or Parquet (``.parquet``), in order; all with the same columns.
        types: types of columns of a CSV file; the types of other columns are inferred.
        columns: read only these columns, all of which must exist; None: read all.
        delimiter: the delimiter of CSV files.
        tolerant: mark bad rows, as in a table of poses; else every row is needed. Of equal rows of Parquet that follow
            each other only the first is kept, and the others are counted.

    Raises:
        RecordingError: a file is missing, broken or empty, or its columns differ from those of the first file.
    """
    tables: list[pa.Table] = []
    torn: list[dict[int, int]] = []
    numbers: list[Int64 | None] = []
    repeats: list[Int64] = []
    for file in files:
        lines: dict[int, int] = {}
        first_rows: list[Int64] = []
        table = _read_table(file, types, columns, delimiter, lines if tolerant else None, first_rows)
        torn.append(lines)
        numbers.append(first_rows[0] if first_rows else None)
        repeats.append(first_rows[1] if first_rows else np.zeros(table.num_rows, np.int64))
        if tables and table.column_names != tables[0].column_names:
            odd = sorted(set(table.column_names) ^ set(tables[0].column_names)) or table.column_names
            raise RecordingError(
                f"its columns differ from those of {files[0].name}: {', '.join(odd)}",
                file=file,
                expected=f"the columns {', '.join(tables[0].column_names)} in every file of the drive",
            )
        tables.append(table)
    lengths = [table.num_rows for table in tables]
    if not sum(lengths):
        raise RecordingError("no rows", file=files[0], expected="at least one row", remedy="leave the recording out")
    starts = [int(start) for start in np.concatenate(([0], np.cumsum(lengths)[:-1]))]
    # A column may be whole numbers in one file and decimals in another; if it is text in one, it becomes text in all.
    types_of = [{table.schema.field(index).type for table in tables} for index in range(tables[0].num_columns)]
    mixed = [
        index for index, column_types in enumerate(types_of) if len(column_types) > 1 and pa.string() in column_types
    ]
    tables = [_to_text(table, mixed) for table in tables]
    table = pa.concat_tables(tables, promote_options="permissive")
    faults = None
    if tolerant:
        width = len(read_header(files[0], delimiter)[0]) if files[0].suffix != ".parquet" else 0
        faults = RowFaults(
            table.num_rows,
            [
                (start + line - 2 - number, _torn_line_error(file, line, cells, width))
                for file, start, lines in zip(files, starts, torn)
                for number, (line, cells) in enumerate(sorted(lines.items()))
            ],
            repeats=np.concatenate(repeats) if any(one is not None for one in numbers) else None,
        )
    lines_left_out = tuple(tuple(sorted(lines)) for lines in torn)
    return RecordingRows(table, tuple(files), tuple(starts), lines_left_out, faults, tuple(numbers))


def _to_text(table: pa.Table, columns: Sequence[int]) -> pa.Table:
    for index in columns:
        table = table.set_column(index, table.column_names[index], table.column(index).cast(pa.string()))
    return table


def _torn_line_error(file: Path, line: int, cells: int, width: int) -> RecordingError:
    return RecordingError(
        count_of(cells, "cell"),
        file=file,
        place=f"line {line}",
        expected=f"{count_of(width, 'cell')}, as in the header",
        remedy="correct or remove the line",
    )


def _number(cell: str | None) -> float:
    """Convert a cell to a number; NaN if it holds none."""
    try:
        return float(cell) if cell is not None and "_" not in cell else np.nan
    except ValueError:
        return np.nan


def read_header(file: Path, delimiter: str | None = None) -> tuple[list[str], str]:
    """Read the column names of a CSV file and its delimiter.

    Args:
        file: the file.
        delimiter: the delimiter; None: the most frequent of ``, ; tab |`` in the header.

    Raises:
        RecordingError: the file is missing or empty.
    """
    try:
        with file.open(encoding="utf-8-sig", errors="replace") as lines:
            first = lines.readline().rstrip("\r\n")
    except OSError as error:
        raise unreadable_error(file, error) from error
    if not first:
        raise RecordingError("empty", file=file, expected="a header line with the names of the columns")
    used = delimiter or max(",;\t|", key=first.count)
    return [name.strip().strip('"') for name in first.split(used)], used


def _read_table(
    file: Path,
    types: Mapping[str, pa.DataType],
    columns: Sequence[str] | None,
    delimiter: str,
    torn: dict[int, int] | None,
    first_rows: list[Int64],
) -> pa.Table:
    """Read one file; ``first_rows`` receives the rows that are kept and the number of equal ones after each."""
    try:
        if file.suffix == ".parquet":
            import pyarrow.parquet as pq

            opened = pq.ParquetFile(file)
            if torn is not None:
                table, kept = read_distinct_rows(opened, file, copies=_COPIES)
                first_rows += [kept, np.diff(kept, append=opened.metadata.num_rows) - 1]
            else:
                require_memory(opened, file, copies=_COPIES)
                table = opened.read(use_threads=False)
        else:
            table = _read_csv(file, types, delimiter, torn)
    except (pa.ArrowInvalid, OSError) as error:
        raise unreadable_error(file, error) from error
    repeated = [name for name, count in Counter(table.column_names).items() if count > 1]
    if repeated:
        raise RecordingError(
            f"{table.column_names.count(repeated[0])} columns have this name",
            file=file,
            place=f"column {repeated[0]}",
            expected="one column per name",
            remedy="rename or remove the others",
        )
    if columns is None:
        return table
    _require_columns(columns, table.column_names, file)
    return table.select(list(columns))


def _require_columns(names: Sequence[str], present: Sequence[str], file: Path) -> None:
    absent = [name for name in names if name not in present]
    if absent:
        raise RecordingError(
            "the column is missing" if len(absent) == 1 else f"{len(absent)} columns are missing",
            file=file,
            place=f"column {', '.join(absent)}",
            expected=f"{', '.join(absent)} among {', '.join(present)}",
        )


def _read_csv(file: Path, types: Mapping[str, pa.DataType], delimiter: str, torn: dict[int, int] | None) -> pa.Table:
    from pyarrow import csv

    names = [name.strip() for name in read_header(file, delimiter)[0]]

    def read(
        source: Path | pa.BufferReader, types: Mapping[str, pa.DataType], *, threads: bool = False, **parsing: Any
    ) -> pa.Table:
        return csv.read_csv(
            source,
            read_options=csv.ReadOptions(use_threads=threads, column_names=names, skip_rows=1),
            parse_options=csv.ParseOptions(delimiter=delimiter, **parsing),
            convert_options=csv.ConvertOptions(column_types=dict(types), strings_can_be_null=True),
        )

    try:
        return read(file, types, threads=True)
    except pa.ArrowInvalid:
        if torn is None:
            # Lines are counted only with one thread: read again for an error that names the line.
            return read(file, types)

    def leave_out(row: csv.InvalidRow) -> str:
        torn[row.number] = row.actual_columns
        return "skip"

    # Slower, so only for a file with bad rows: read all cells as text, without lines that have too few or many cells.
    text = file.read_bytes().decode(errors="replace").encode()
    return read(pa.BufferReader(text), dict.fromkeys(types, pa.string()), invalid_row_handler=leave_out)
