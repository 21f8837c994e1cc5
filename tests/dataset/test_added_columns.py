"""Datasets that were written before a column was added to the schema are read with nulls there."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

import mirror
from mirror.dataset.index.build import build_index
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.recordings.discovery import find_recordings
from mirror.schema.documents import Roi
from mirror.schema.files import conform, read_table
from mirror.schema.tables import ADDED, BOXES
from tests.builders.index import segment_folder, tamper
from tests.recordings.formats.nuscenes import write_nuscenes
from tests.recordings.formats.street import straight_drive

CENTRES = {"east": 8.0, "west": -8.0}


def make_dataset(root: Path) -> Path:
    """A dataset of a nuScenes drive in two scenes, with attributes of its boxes."""
    source = write_nuscenes(root / "nuscenes", [straight_drive()], location="town")
    scenes = [Roi(scene_id=name, frame="town", x_m=x, y_m=0.0, radius_m=60.0) for name, x in CENTRES.items()]
    recordings = find_recordings([source]).recordings
    assert not ingest_recordings(recordings, scenes, root / "d", IngestOptions(workers=1)).failures
    return root / "d"


def drop_column(file: Path) -> None:
    """Write a table as it was before the column was added, and state its hash in the folder's manifest."""
    table = pq.read_table(file)
    file.unlink()
    pq.write_table(table.drop_columns(list(ADDED)), file)
    folder = next(parent for parent in file.parents if (parent / "manifest.json").is_file())
    manifest: dict[str, Any] = json.loads((folder / "manifest.json").read_text())
    data = file.read_bytes()
    entry = {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    manifest["files"][file.relative_to(folder).as_posix()] = entry
    (folder / "manifest.json").write_text(json.dumps(manifest))


def attributes_of(dataset: mirror.Dataset) -> dict[str, set[tuple[str, ...]]]:
    return {
        scene: {
            attributes for frame in dataset.where(scene=scene).frames() for attributes in frame.boxes("ego").attributes
        }
        for scene in CENTRES
    }


def test_attributes_of_a_recording_are_in_the_dataset(tmp_path: Path) -> None:
    dataset = mirror.open(make_dataset(tmp_path))
    assert attributes_of(dataset)["east"] >= {("vehicle.moving",), ("vehicle.parked",)}
    rows = dataset.sql("select attributes from boxes where 'vehicle.parked' in attributes")
    assert rows.num_rows and set(map(tuple, rows.column(0).to_pylist())) == {("vehicle.parked",)}


@pytest.mark.parametrize("scenes", [["east"], ["east", "west"]], ids=["one scene", "all scenes"])
def test_an_index_without_the_column_is_read(tmp_path: Path, scenes: list[str]) -> None:
    root = make_dataset(tmp_path)
    for scene in scenes:
        drop_column(segment_folder(root) / "boxes" / f"{scene}.parquet")
    tamper(root, {})
    dataset = mirror.open(root)
    found = attributes_of(dataset)
    assert found["east"] == {()} and (found["west"] == {()}) == ("west" in scenes)
    assert dataset.table("boxes").column("attributes").null_count > 0
    assert dataset.sql("select count(*) from boxes").column(0)[0].as_py() == dataset.table("boxes").num_rows


def test_layers_without_the_column_are_indexed(tmp_path: Path) -> None:
    root = make_dataset(tmp_path)
    for file in (root / "traversals").glob("*/layers/boxes/*/boxes.parquet"):
        drop_column(file)
        assert read_table(file, BOXES).column("attributes").null_count == read_table(file, BOXES).num_rows
    build_index(root)
    assert attributes_of(mirror.open(root)) == {scene: {()} for scene in CENTRES}


def test_rows_without_the_column_are_rows_of_the_table(tmp_path: Path) -> None:
    """Annotators and recordings of other packages do not state it."""
    rows = BOXES.schema.empty_table().drop_columns(["attributes"])
    assert conform(rows, BOXES, file="boxes").schema == BOXES.schema
