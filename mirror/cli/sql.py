"""``mirror sql DATASET "select ..."``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode, UsageError

if TYPE_CHECKING:
    import pyarrow as pa

_EXAMPLES = (
    'mirror sql demo/dataset "select light, count(*) as n, sum(path_m) / 1000 as km from traversals group by light"',
    'mirror sql demo/dataset "select camera, count(*) as images from images group by all" --out images.csv',
)
_SUFFIXES: Final = (".csv", ".parquet", ".arrow")
_PIPE_WIDTH: Final = 10_000
_LONGEST_CELL: Final = 80


@dataclass(frozen=True)
class Arguments:
    """Run an SQL query over the tables of a dataset with DuckDB, and print the result or write it to a file.

    The tables are those of docs/schema.md: scenes, traversals, passes, frames, images, ego_poses, calibrations, boxes,
    masks, depth, points. The query must be one SELECT statement; it reads nothing but these tables and writes nothing.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    query: tyro.conf.Positional[str]
    """The query; - reads it from standard input."""
    out: Annotated[Path | None, help_text(default="print a table", metavar="FILE")] = None
    """File for the result: .csv, .parquet or .arrow (IPC)."""
    rows: int = 40
    """Largest number of rows to print."""
    json: bool = False
    """Print the result as JSON: one object a row."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror sql", examples=_EXAMPLES)
    if arguments.out is not None and arguments.out.suffix not in _SUFFIXES:
        raise UsageError(f"{arguments.out}", place="--out", expected=f"a name that ends in {', '.join(_SUFFIXES)}")
    if arguments.rows < 1:
        raise UsageError(f"{arguments.rows} rows", place="--rows", expected="at least one")

    import sys

    from mirror.dataset import open as open_dataset
    from mirror.schema.folders import require_output_file

    if arguments.out is not None:
        require_output_file(arguments.out)
    query = sys.stdin.read() if arguments.query == "-" else arguments.query
    result = open_dataset(arguments.dataset).sql(query)
    if arguments.out is not None:
        from mirror.schema.files import write_bytes

        write_bytes(arguments.out, _encode(result, arguments.out.suffix))
        counted = {"rows": result.num_rows, "out": str(arguments.out)}
        print(json.dumps(counted) if arguments.json else f"{result.num_rows:,} rows: {arguments.out}")
    elif arguments.json:
        print(json.dumps([_plain(row) for row in result.to_pylist()]))
    else:
        _print(result, arguments.rows)
    return ExitCode.DONE


def _encode(table: pa.Table, suffix: str) -> bytes:
    import pyarrow as pa

    if suffix == ".csv":
        return _encode_csv(table)
    sink = pa.BufferOutputStream()
    if suffix == ".parquet":
        import pyarrow.parquet as pq

        pq.write_table(table, sink, compression="zstd")
    else:
        with pa.ipc.new_file(sink, table.schema) as writer:
            writer.write_table(table)
    return bytes(sink.getvalue())


def _encode_csv(table: pa.Table) -> bytes:
    """Encode as CSV: bytes are hexadecimal, lists and structs are JSON, null is empty, formulas are quoted."""
    from decimal import Decimal

    from mirror.schema.csv_files import Cell, encode_csv

    def encode(value: Any) -> Cell:
        # A decimal is a number here, which JSON does not have.
        plain = value if isinstance(value, Decimal) else _plain(value)
        return json.dumps(plain) if isinstance(plain, list | dict) else plain

    rows = ([encode(cell) for cell in row] for row in zip(*(column.to_pylist() for column in table.columns)))
    return encode_csv(table.column_names, rows)


def _plain(value: Any) -> Any:
    """A value that JSON has: bytes as hexadecimal, NaN as null, dates and times as text."""
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float) and value != value:
        return None
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def _print(table: pa.Table, most: int) -> None:
    from rich.table import Table

    from mirror.cli.output import plain_console

    console = plain_console()
    if not console.is_terminal:
        # A file or a pipe has no width.
        console.width = _PIPE_WIDTH
    printed = Table(box=None, pad_edge=False)
    for field in table.schema:
        numeric = str(field.type).startswith(("int", "uint", "double", "float", "decimal"))
        printed.add_column(field.name, justify="right" if numeric else "left", overflow="fold")
    for row in zip(*(column.to_pylist() for column in table.slice(0, most).columns)):
        printed.add_row(*map(_cell, row))
    console.print(printed)
    if table.num_rows > most:
        console.print(f"... {table.num_rows - most:,} more rows: --rows N, or --out FILE")


def _cell(value: Any) -> str:
    if value is None:
        return "--"
    if isinstance(value, float):
        return f"{value:.6g}"
    plain = _plain(value)
    text = json.dumps(plain) if isinstance(plain, list | dict) else str(plain)
    return text if len(text) <= _LONGEST_CELL else f"{text[: _LONGEST_CELL - 3]}..."
