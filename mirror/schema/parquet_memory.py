"""The memory that a Parquet file takes when it is read: rows that repeat take next to none in the file."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Bool, Int64
from mirror.errors import MirrorError

if TYPE_CHECKING:
    import pyarrow.parquet as pq

_MEMORY: Final = Path("/proc/meminfo")
_OFFSET_BYTES: Final = 8
_BATCH_ROWS: Final = 65_536
# Below this the free memory is not asked for.
_SMALL_BYTES: Final = 1 << 26
# A number of 8 bytes is an object of 24 to 32 bytes, and its place in a dictionary takes 16 to 100 more.
_PYTHON_COPIES: Final = 16.0


class NotEnoughMemoryError(MirrorError):
    """A file holds more than fits into the free memory."""


def require_memory(
    file: pq.ParquetFile,
    path: str | Path,
    columns: Collection[str] | None = None,
    *,
    row_group: int | None = None,
    copies: float = 2.0,
) -> None:
    """Refuse, before reading, rows that do not fit into the free memory; their number alone does not matter.

    The footer gives the rows of each row group; columns of fixed width take their width, others at least what the file
    states. Without ``/proc/meminfo`` nothing is known of the memory, and nothing is refused.

    Args:
        file: the open file.
        path: its path, for the message.
        columns: names of the columns that are read; None: all.
        row_group: the row group that is read; None: all.
        copies: memory of the work on the rows, in multiples of their size.

    Raises:
        NotEnoughMemoryError: the rows do not fit.
    """
    rows = file.metadata.num_rows if row_group is None else file.metadata.row_group(row_group).num_rows
    require_room(copies * decoded_bytes(file, columns, row_group), rows, path)


def read_distinct_rows(file: pq.ParquetFile, path: str | Path, *, copies: float = 2.0) -> tuple[pa.Table, Int64]:
    """Read a Parquet file in batches, without rows that equal the previous row in every column.

    The memory is that of the rows that are kept and of one batch. A row with a null or NaN equals no other one, unless
    the column has only nulls.

    Args:
        file: the open file.
        path: its path, for the message.
        copies: memory of the work on the kept rows, in multiples of their size.

    Returns:
        The N rows that are kept, and (N,) their numbers in the file.

    Raises:
        NotEnoughMemoryError: the rows that are kept do not fit.
    """
    kept: list[pa.RecordBatch] = []
    numbers: list[Int64] = []
    last: pa.RecordBatch | None = None
    size = start = 0
    for batch in file.iter_batches(_BATCH_ROWS, use_threads=False):
        differs = np.ones(len(batch), np.bool_)
        if last is None:
            differs[1:] = _differ_from_previous(batch)
        else:
            differs[:] = _differ_from_previous(pa.concat_batches([last, batch]))
        if differs.any():
            chosen = batch if differs.all() else batch.filter(pa.array(differs))
            kept.append(chosen)
            numbers.append(start + np.flatnonzero(differs))
            size += chosen.nbytes
            require_room(copies * size, start + len(batch), path)
        last = batch.slice(len(batch) - 1)
        start += len(batch)
    table = pa.Table.from_batches(kept, None if kept else file.schema_arrow)
    return table, np.concatenate([np.empty(0, np.int64), *numbers])


def _differ_from_previous(rows: pa.RecordBatch) -> Bool:
    """(N - 1,) whether each row after the first differs from the one before it."""
    differs = np.zeros(len(rows) - 1, np.bool_)
    for column in rows.columns:
        values = column.dictionary_decode() if pa.types.is_dictionary(column.type) else column
        if values.null_count == len(values):
            continue
        try:
            unequal = pc.fill_null(pc.not_equal(values[1:], values[:-1]), True)
        except pa.ArrowNotImplementedError:
            # Lists and structures are not compared.
            return np.ones(len(rows) - 1, np.bool_)
        differs |= unequal.to_numpy(zero_copy_only=False)
    return differs


def require_room(needed: float, rows: int, path: str | Path) -> None:
    """Refuse rows that do not fit into the free memory.

    Args:
        needed: memory of the rows and the work on them, in bytes.
        rows: their number, for the message.
        path: their file, for the message.

    Raises:
        NotEnoughMemoryError: they do not fit.
    """
    free = free_bytes() if needed > _SMALL_BYTES else None
    if free is not None and needed > free:
        raise NotEnoughMemoryError(
            f"{rows:,} rows need about {needed / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB are free",
            file=path,
            expected="rows that fit into memory",
            remedy="use a machine with more memory, or divide the file",
        )


def read_python_rows(path: Path) -> list[dict[str, Any]]:
    """Read all rows of a Parquet file as Python objects.

    Raises:
        NotEnoughMemoryError: the rows do not fit.
        OSError: the file is missing, or is not Parquet (`pyarrow.ArrowInvalid`).
    """
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        require_memory(file, path, copies=_PYTHON_COPIES)
        rows: list[dict[str, Any]] = file.read().to_pylist()
        return rows


def decoded_bytes(file: pq.ParquetFile, columns: Collection[str] | None = None, row_group: int | None = None) -> int:
    """Return the size of the decoded columns of a file in bytes, from its footer.

    It is a lower bound for columns of varying width.
    """
    widths = {field.name: _width(field.type) for field in file.schema_arrow}
    size = 0
    for number in range(file.metadata.num_row_groups) if row_group is None else [row_group]:
        group = file.metadata.row_group(number)
        for index in range(group.num_columns):
            chunk = group.column(index)
            name = chunk.path_in_schema.partition(".")[0]
            if columns is None or name in columns:
                width = widths.get(name)
                size += chunk.num_values * (width or _OFFSET_BYTES) + (0 if width else chunk.total_uncompressed_size)
    return size


def free_bytes() -> int | None:
    """Return the memory, in bytes, that is free or that the system can free; None if unknown."""
    try:
        lines = _MEMORY.read_text().splitlines()
    except OSError:
        return None
    found = {name: int(rest.split()[0]) * 1024 for name, _, rest in (line.partition(":") for line in lines) if rest}
    free = found.get("MemAvailable")
    limit = _address_space()
    return free if limit is None or free is None else min(free, limit)


def _address_space() -> int | None:
    """Addresses that the process may still take (``ulimit -v``); None: it has no limit."""
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return None
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return max(0, limit - pages * resource.getpagesize())


def _width(kind: pa.DataType) -> int:
    """Bytes of a value; 0: they vary."""
    return kind.byte_width if pa.types.is_primitive(kind) and kind.bit_width >= 8 else 0
