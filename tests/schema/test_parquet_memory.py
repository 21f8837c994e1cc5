"""Small Parquet files whose rows take gigabytes: the memory that they need refuses them, never the number of rows."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mirror.metrics.safety.state_file import read_state_log
from mirror.recordings.readers.arrow_tables import read_parquet
from mirror.recordings.tabular import read_rows
from mirror.schema.files import read_table
from mirror.schema.parquet_memory import NotEnoughMemoryError, decoded_bytes, free_bytes
from mirror.schema.rollout_tables import STATES
from mirror.schema.tables import EGO_POSES, Table

ROWS = 20_000_000
GROUP = 1_000_000


def repeated(path: Path, columns: dict[str, pa.DataType], rows: int = ROWS) -> Path:
    """A file whose rows are all equal."""
    arrays = {}
    for name, kind in columns.items():
        value = "a" if pa.types.is_string(kind) or pa.types.is_dictionary(kind) else 1
        arrays[name] = pa.array([value] * GROUP) if value == "a" else pa.array(np.ones(GROUP)).cast(kind)
    table = pa.table(arrays)
    with pq.ParquetWriter(path, table.schema, compression="zstd") as writer:
        for _ in range(rows // GROUP):
            writer.write_table(table)
    return path


@contextmanager
def memory(free: int) -> Iterator[None]:
    """Limit the memory that this process may still take."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + free, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


POSES = {"timestamp_ns": pa.int64(), "longitude_deg": pa.float64(), "latitude_deg": pa.float64()}


def test_equal_rows_that_do_not_fit_are_refused_before_they_are_read(tmp_path: Path) -> None:
    file = repeated(tmp_path / "poses.parquet", POSES)
    assert file.stat().st_size < 1_000_000
    assert decoded_bytes(pq.ParquetFile(file)) == ROWS * 24
    before = pa.total_allocated_bytes()
    with memory(400_000_000):
        with pytest.raises(NotEnoughMemoryError, match="20,000,000 rows") as caught:
            read_rows([file], types={}, tolerant=True)
        assert caught.value.file == str(file) and caught.value.remedy
        with pytest.raises(NotEnoughMemoryError):
            read_parquet(file, pa.schema(list(POSES.items())))
    assert pa.total_allocated_bytes() == before
    # As many rows pass where they fit: only the column that is read counts.
    assert len(read_parquet(file, pa.schema([("timestamp_ns", pa.int64())]))) == ROWS


@pytest.mark.parametrize("table", [EGO_POSES, STATES], ids=lambda table: table.name)
def test_tables_and_state_logs_are_refused_likewise(table: Table, tmp_path: Path) -> None:
    wide = {field.name: field.type for field in table.schema if pa.types.is_primitive(field.type)}
    others = {field.name: pa.string() for field in table.schema if field.name not in wide}
    file = repeated(tmp_path / "table.parquet", {**wide, **others}, 4 * GROUP)
    with memory(150_000_000), pytest.raises(NotEnoughMemoryError):
        read_table(file, table)
    if table is STATES:
        with memory(150_000_000), pytest.raises(NotEnoughMemoryError):
            read_state_log(file)


def test_free_memory_is_known_here() -> None:
    free = free_bytes()
    assert free is not None and free > 1_000_000
