from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mirror.errors import DatasetError, SchemaError
from mirror.schema.document import schema_page
from mirror.schema.documents import DatasetDocument, Roi
from mirror.schema.files import conform, encode_table, read_json, read_table, write_bytes, write_table
from mirror.schema.index_tables import INDEX_BY_SCENE, INDEX_GLOBAL
from mirror.schema.tables import EGO_POSES, LAYERS, PASSES, RECORDED
from mirror.schema.version import DATASET_VERSION, SCHEMA_VERSION, require_readable

ROOT = Path(__file__).resolve().parents[2]


def poses(rows: int) -> pa.Table:
    values = {name: [float(row) for row in range(rows)] for name in EGO_POSES.schema.names}
    values["timestamp_ns"] = list(range(rows))
    values["orientation"] = ["recorded"] * rows
    return pa.table(values)


def test_schema_page_is_current() -> None:
    page = (ROOT / "docs" / "schema.md").read_text()
    assert page == schema_page(), "run: python -m mirror.schema.document docs/schema.md"


@pytest.mark.parametrize("table", [PASSES, *RECORDED, *LAYERS, *INDEX_GLOBAL, *INDEX_BY_SCENE], ids=lambda t: t.place)
def test_every_column_is_documented_and_sorted_by_columns_that_exist(table) -> None:
    for field in table.schema:
        assert len((field.metadata or {})[b"doc"]) > 5
    assert set(table.sorted_by) <= set(table.schema.names)


def test_file_contains_the_documentation_of_its_columns(tmp_path: Path) -> None:
    write_table(tmp_path / "ego_poses.parquet", poses(2), EGO_POSES)
    field = pq.read_schema(tmp_path / "ego_poses.parquet").field("tx_m")
    assert field.metadata[b"doc"] == EGO_POSES.schema.field("tx_m").metadata[b"doc"]


def test_round_trip_row_groups_and_equal_bytes(tmp_path: Path) -> None:
    data = encode_table(poses(10), EGO_POSES, row_groups=[4, 6])
    assert data == encode_table(poses(10), EGO_POSES, row_groups=[4, 6])
    path = tmp_path / "a.parquet"
    write_bytes(path, data)
    assert pq.ParquetFile(path).num_row_groups == 2
    assert read_table(path, EGO_POSES).equals(conform(poses(10), EGO_POSES, file="x"))
    assert read_table(path, EGO_POSES, ["tx_m"]).column_names == ["tx_m"]


def test_empty_table_round_trips(tmp_path: Path) -> None:
    write_table(tmp_path / "a.parquet", poses(0), EGO_POSES)
    assert read_table(tmp_path / "a.parquet", EGO_POSES).num_rows == 0


def test_null_is_named_by_column_and_row(tmp_path: Path) -> None:
    table = poses(5)
    table = table.set_column(table.column_names.index("qw"), "qw", pa.array([1.0, 1.0, None, 1.0, 1.0]))
    with pytest.raises(SchemaError, match=r"column qw, row 2"):
        write_table(tmp_path / "a.parquet", table, EGO_POSES)
    assert not list(tmp_path.iterdir())


def test_missing_and_wrong_columns_are_named() -> None:
    with pytest.raises(SchemaError, match="column tx_m"):
        conform(poses(1).drop_columns(["tx_m"]), EGO_POSES, file="f")
    with pytest.raises(SchemaError, match="column speed"):
        conform(poses(1).append_column("speed", pa.array([1.0])), EGO_POSES, file="f")
    text = poses(1).set_column(1, "qw", pa.array(["one"]))
    with pytest.raises(SchemaError, match="column qw"):
        conform(text, EGO_POSES, file="f")


def test_truncated_parquet_names_file_and_table(tmp_path: Path) -> None:
    path = tmp_path / "ego_poses.parquet"
    path.write_bytes(encode_table(poses(50), EGO_POSES)[:-200])
    with pytest.raises(SchemaError, match=r"ego_poses\.parquet"):
        read_table(path, EGO_POSES)
    with pytest.raises(DatasetError, match="missing"):
        read_table(tmp_path / "none.parquet", EGO_POSES)


@pytest.mark.parametrize(
    ("found", "says"),
    [
        ("9.0.0", "upgrade"),
        ("1.99.0", "upgrade"),
        ("0.9.0", "older"),
        ("one", "not a version"),
        (None, "not a version"),
    ],
)
def test_unreadable_versions_are_refused_with_a_remedy(found, says: str, tmp_path: Path) -> None:
    with pytest.raises(SchemaError, match=says) as caught:
        require_readable(found, "dataset.json")
    assert caught.value.remedy
    document = {"schema_version": found, "trigger": {}, "cleaning": {}}
    (tmp_path / "dataset.json").write_text(json.dumps(document))
    with pytest.raises(SchemaError, match=r"dataset\.json"):
        read_json(tmp_path / "dataset.json", DatasetDocument)


def test_version_of_a_table_is_checked(tmp_path: Path) -> None:
    data = conform(poses(1), EGO_POSES, file="f").replace_schema_metadata({"mirror_schema_version": "7.0.0"})
    pq.write_table(data, tmp_path / "a.parquet")
    with pytest.raises(SchemaError, match=r"7\.0\.0 is newer"):
        read_table(tmp_path / "a.parquet", EGO_POSES)
    require_readable(SCHEMA_VERSION, "f")


def test_broken_json_names_line_and_key(tmp_path: Path) -> None:
    path = tmp_path / "dataset.json"
    path.write_text('{"schema_version": "1.0.0",\n "trigger": {')
    with pytest.raises(SchemaError, match="line 2"):
        read_json(path, DatasetDocument)
    document = {"schema_version": DATASET_VERSION, "trigger": {"min_path_m": -3}, "cleaning": {}}
    path.write_text(json.dumps(document))
    with pytest.raises(SchemaError, match=r"trigger\.min_path_m"):
        read_json(path, DatasetDocument)


def test_failed_write_leaves_the_previous_file(tmp_path: Path) -> None:
    path = tmp_path / "kept"
    path.write_bytes(b"before")
    with pytest.raises(DatasetError, match="cannot be written"):
        write_bytes(path / "below_a_file", b"x")
    assert path.read_bytes() == b"before"


@pytest.mark.parametrize(
    "values", [{}, {"longitude_deg": 1.0}, {"longitude_deg": 1, "latitude_deg": 1, "frame": "f", "x_m": 0, "y_m": 0}]
)
def test_roi_is_geodetic_or_local(values) -> None:
    with pytest.raises(ValueError, match="either longitude_deg and latitude_deg, or frame"):
        Roi(scene_id="a", **values)
