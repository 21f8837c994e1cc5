"""Casts that keep every digit: stamps as floats and as Arrow timestamps, in tables of every reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.feather as feather
import pytest

from mirror.errors import RecordingError, SchemaError
from mirror.recordings.readers.arrow_tables import read_feather
from mirror.schema.casting import cast_exactly
from mirror.schema.files import conform
from mirror.schema.tables import EGO_POSES

STAMPS = np.array([1_772_359_200_123_456_000, 1_772_359_200_223_456_000])
NS = pa.field("timestamp_ns", pa.int64())


@pytest.mark.parametrize("unit", ["us", "ns"])
@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
def test_timestamps_become_nanoseconds_whatever_their_unit(unit: str, zone: str | None) -> None:
    column = pa.chunked_array([pa.array(STAMPS, pa.timestamp("ns", zone)).cast(pa.timestamp(unit, zone))])
    assert cast_exactly(column, NS).to_pylist() == STAMPS.tolist()
    with pytest.raises(pa.ArrowInvalid, match="another unit"):
        cast_exactly(column, pa.field("key.frame_timestamp_micros", pa.int64()))


def test_floats_are_taken_up_to_2_53() -> None:
    exact = pa.chunked_array([np.array([2.0**53, -5.0])])
    assert cast_exactly(exact, NS).to_pylist() == [2**53, -5]
    for column in (STAMPS.astype(np.float64), np.array([-(2.0**60)])):
        with pytest.raises(pa.ArrowInvalid, match=r"2\^53"):
            cast_exactly(pa.chunked_array([column]), NS)


def test_tables_name_the_column_that_has_lost_digits(tmp_path: Path) -> None:
    columns = {field.name: pa.nulls(2, field.type) for field in EGO_POSES.schema}
    lost = pa.table({**columns, "timestamp_ns": STAMPS.astype(np.float64)})
    with pytest.raises(SchemaError, match=r"2\^53") as caught:
        conform(lost, EGO_POSES, file="poses.parquet")
    assert caught.value.place == "column timestamp_ns"
    feather.write_feather(lost.select(["timestamp_ns"]), tmp_path / "poses.feather")
    with pytest.raises(RecordingError, match=r"2\^53"):
        read_feather(tmp_path / "poses.feather", pa.schema([NS]))
