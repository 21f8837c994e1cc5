"""Small Parquet files whose rows take gigabytes: the memory that they need refuses them, never the number of rows."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mirror.metrics.safety.state_file import read_state_log
from mirror.recordings.protocol import Track
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
            read_rows([file], types={})
        assert caught.value.file == str(file) and caught.value.remedy
        with pytest.raises(NotEnoughMemoryError):
            read_parquet(file, pa.schema(list(POSES.items())))
    assert pa.total_allocated_bytes() == before
    # As many rows pass where they fit: only the column that is read counts.
    assert len(read_parquet(file, pa.schema([("timestamp_ns", pa.int64())]))) == ROWS


def test_equal_poses_are_read_in_the_memory_of_a_batch(tmp_path: Path) -> None:
    file = repeated(tmp_path / "poses.parquet", POSES, 8 * GROUP)
    decoded = decoded_bytes(pq.ParquetFile(file))
    assert decoded == 192_000_000 and peak_of(file) < decoded / 2


def peak_of(file: Path) -> int:
    """Memory in bytes that reading a file as poses takes at most, in a process of its own."""
    script = f"""
from pathlib import Path
import pyarrow.parquet
from mirror.recordings.tabular import read_rows
peak = lambda: int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) * 1024
before = peak()
rows = read_rows([Path({str(file)!r})], types={{}}, tolerant=True)
assert len(rows) == 1, len(rows)
print(peak() - before)
"""
    return int(subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout)


def test_equal_rows_are_counted_and_other_rows_keep_their_numbers(tmp_path: Path) -> None:
    number = np.repeat([0, 1, 2, 1, 3], [70_000, 1, 65_536, 2, 9])
    latitude = 48.0 + 1e-5 * number
    latitude[number == 2] = np.nan
    kind = np.where(number == 1, "a", "b")
    columns = {"timestamp_ns": number, "latitude_deg": latitude, "nothing": pa.nulls(len(number)), "kind": kind}
    file = tmp_path / "poses.parquet"
    pq.write_table(pa.table(columns), file, row_group_size=50_000)
    rows = read_rows([file], types={}, tolerant=True)
    nan = np.arange(70_001, 70_001 + 65_536)
    assert rows.locate(1) == (file, "row 70000") and rows.locate(len(rows) - 1) == (file, "row 135539")
    assert rows.column("timestamp_ns").to_pylist() == [0, 1, *[2] * len(nan), 1, 3]
    bad = np.asarray(rows.column("kind")) == "a"
    rows.refuse(bad, "kind", "not b", expected="b", remedy="correct it")
    track = rows.without_bad(Track(rows.stamps("timestamp_ns", "unix_ns"), *[rows.floats("latitude_deg")] * 2))
    assert track.repeats == 69_999 + 8
    assert track.bad is not None and track.bad.counts() == {"number": 3}
    assert len(track) + track.repeats + len(track.bad) == len(number)


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
