"""JSON lists as columns: the same values as Python's JSON, wherever the blocks of the file end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from mirror.errors import RecordingError
from mirror.recordings.readers import json_tables
from mirror.recordings.readers.json_tables import matrix_of, read_columns

SCHEMA = pa.schema(
    [
        pa.field("token", pa.string(), nullable=False),
        pa.field("timestamp", pa.int64(), nullable=False),
        pa.field("translation", pa.list_(pa.float64(), 3), nullable=False),
        pa.field("width", pa.float64()),
    ]
)


def rows_of(count: int) -> list[dict[str, object]]:
    random = np.random.default_rng(3)
    return [
        {
            "unused": "x" * int(random.integers(20)),
            "token": f"{int(random.integers(2**60)):016x}",
            "timestamp": 1_532_402_927_647_951 + number,
            "translation": random.normal(size=3).round(6).tolist(),
            "width": None if number % 3 else 1600,
        }
        for number in range(count)
    ]


@pytest.mark.parametrize("indent", [None, 0, 3])
@pytest.mark.parametrize("block", [*range(230, 260), 1 << 20])
def test_blocks_may_end_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, block: int, indent: int | None
) -> None:
    monkeypatch.setattr(json_tables, "_BLOCK_BYTES", block)
    rows = rows_of(30)
    file = tmp_path / "table.json"
    file.write_text("  " + json.dumps(rows, indent=indent).replace("},", "} \n ,") + "\n")
    table = read_columns(file, SCHEMA)
    assert table.column("token").to_pylist() == [row["token"] for row in rows]
    assert table.column("timestamp").to_pylist() == [row["timestamp"] for row in rows]
    assert matrix_of(table.column("translation")).tolist() == [row["translation"] for row in rows]
    assert table.column("width").to_pylist() == [row["width"] for row in rows]


def test_an_empty_list_has_no_rows(tmp_path: Path) -> None:
    (tmp_path / "table.json").write_text(" [ ] \n")
    table = read_columns(tmp_path / "table.json", SCHEMA)
    assert table.num_rows == 0 and matrix_of(table.column("translation")).shape == (0, 3)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "not valid JSON"),
        ("[", "not valid JSON"),
        ("{}", "not a list of objects"),
        ("[1, 2]", "not a list of objects"),
        ('[{"token": "a"} {"token": "b"}]', "not valid JSON"),
        ('[{"token": "a", "token": "b"}]', "stands twice"),
        ('[{"token": "a"}', "not valid JSON"),
        ('[{"token": "a"}]', "no value 'timestamp'"),
        ('[{"token": 7}]', "cannot be read"),
        ('[{"token": "a", "timestamp": 99999999999999999999, "translation": [0, 0, 0]}]', "cannot be read"),
        ('[{"token": "a", "timestamp": 1, "translation": [0, 0]}]', "no value 'translation'"),
        ('[{"token": "a", "timestamp": 1, "translation": [0, null, 0]}]', "no value 'translation'"),
        ('[{"token": "a", "timestamp": 1, "translation": {"x": 0}}]', "cannot be read"),
    ],
)
def test_other_documents_are_refused(tmp_path: Path, text: str, problem: str) -> None:
    file = tmp_path / "table.json"
    file.write_text(text)
    with pytest.raises(RecordingError, match=problem) as caught:
        read_columns(file, SCHEMA)
    assert caught.value.file == str(file) and caught.value.remedy is not None


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="missing"):
        read_columns(tmp_path / "table.json", SCHEMA)
