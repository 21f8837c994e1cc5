"""Reads columns of Feather and Parquet files with stated types."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Float64
from mirror.errors import RecordingError
from mirror.recordings.opening import unreadable_error
from mirror.schema.casting import cast_exactly
from mirror.schema.parquet_memory import require_memory


def read_feather(file: Path, schema: pa.Schema) -> pa.Table:
    """Read some columns of a Feather file.

    Args:
        file: the file.
        schema: columns and types; a column that is not nullable may not hold nulls.

    Raises:
        RecordingError: the file is missing or broken, or a column is missing, of another type or has a null.
    """
    import pyarrow.feather as feather

    return _read(file, schema, lambda: feather.read_table(file, memory_map=False))


def read_parquet(file: Path, schema: pa.Schema) -> pa.Table:
    """Read some columns of a Parquet file, decoding only these; see `read_feather`.

    Raises:
        RecordingError: as `read_feather`.
    """
    import pyarrow.parquet as parquet

    def read() -> pa.Table:
        opened = parquet.ParquetFile(file)
        present = set(opened.schema_arrow.names)
        require_memory(opened, file, set(schema.names))
        return opened.read([name for name in schema.names if name in present], use_threads=False)

    return _read(file, schema, read)


def matrix_of(table: pa.Table, names: tuple[str, ...]) -> Float64:
    """Convert K columns of numbers to float64 values (N, K)."""
    return np.column_stack([np.asarray(table.column(name), np.float64) for name in names]).reshape(-1, len(names))


def _read(file: Path, schema: pa.Schema, read: Callable[[], Any]) -> pa.Table:
    try:
        table = read()
        table.validate(full=True)
    except (OSError, pa.ArrowException, ValueError, MemoryError) as error:
        raise unreadable_error(file, error) from error
    columns = []
    for field in schema:
        if table.column_names.count(field.name) != 1:
            raise RecordingError(
                f"no column {field.name!r}" if field.name not in table.column_names else "a column stands twice",
                file=file,
                place=f"column {field.name}",
                expected=", ".join(schema.names),
                remedy="download the file again",
            )
        column = table.column(field.name)
        try:
            column = cast_exactly(column, field)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
            raise RecordingError(
                f"values of type {column.type} cannot be used ({str(error).splitlines()[0]})",
                file=file,
                place=f"column {field.name}",
                expected=str(field.type),
                remedy="download the file again",
            ) from error
        if not field.nullable and column.null_count:
            raise RecordingError(
                "a null",
                file=file,
                place=f"column {field.name}, row {pc.index(pc.is_null(column), True).as_py()}",
                expected="a value",
                remedy="download the file again",
            )
        columns.append(column)
    return pa.Table.from_arrays(columns, schema=schema)
