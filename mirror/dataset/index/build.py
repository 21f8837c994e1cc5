"""Building the index: only the scenes whose inputs changed, files first, the manifest last."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from mirror.dataset.generation import recover, release, supersede
from mirror.dataset.index.global_tables import (
    accepted_passes,
    encode_global,
    read_passes,
    rows_to_table,
)
from mirror.dataset.index.inputs import Inputs, read_inputs
from mirror.dataset.index.scene_tables import plain_schema, write_scene_tables
from mirror.dataset.index.traversal_table import PreviousTraversals, TraversalTable
from mirror.dataset.layout import MANIFEST, Layout, read_manifest
from mirror.dataset.store import Store
from mirror.errors import DatasetError, SchemaError
from mirror.schema.documents import DatasetDocument, FileEntry, Manifest
from mirror.schema.files import read_json, read_table, sha256_bytes, unwritable_error, write_bytes, write_json
from mirror.schema.tables import INDEX_BY_SCENE, ROW_GROUPS, TRAVERSALS

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class IndexReport:
    """What building the index did.

    Attributes:
        scenes_written: scenes whose tables were derived anew.
        scenes_kept: scenes whose inputs had not changed.
        rows: number of rows in the index, by table.
        seconds: how long it took.
    """

    scenes_written: tuple[str, ...]
    scenes_kept: tuple[str, ...]
    rows: Mapping[str, int]
    seconds: float


def build_index(
    root: str | Path, *, force: bool = False, whole: bool = False, progress: Progress | None = None
) -> IndexReport:
    """Derive the index tables; what is up to date is kept.

    The bytes are a pure function of the rest of the dataset, whatever the order of ingest. The caller holds the
    dataset's writer lock.

    Args:
        root: the dataset's folder.
        force: derive every scene, whatever is there.
        whole: also hold the sizes of all recorded tables against their manifests, of scenes that are kept too.
        progress: called with the traversals done and to do.

    Raises:
        DatasetError: no dataset, or a file of it is missing or not the one that was named.
        SchemaError: a file is broken, or of another schema version.
    """
    start = time.perf_counter()
    layout = Layout(Path(root))
    recover(layout)
    read_json(layout.document, DatasetDocument)
    inputs = read_inputs(Store(layout.root))
    if whole:
        _require_whole(layout, inputs)
    previous = None if force else _intact_manifest(layout)
    kept = _unchanged(previous, inputs)
    if previous is not None and previous.derived_from == inputs.fingerprints:
        _remove_strays(layout, previous)
        release(layout)
        return IndexReport((), tuple(inputs.scenes), _rows(layout), time.perf_counter() - start)

    passes = read_passes(layout, inputs)
    ledger = accepted_passes(passes)
    to_do = sum(traversal.scene_id not in kept for traversal in inputs.traversals.values())
    count = 0

    def take(row: Mapping[str, Any]) -> None:
        nonlocal count
        traversals.add(row)
        count += 1
        if progress is not None:
            progress(count, to_do)

    entries: dict[str, FileEntry] = {}
    groups = [_kept_row_groups(layout, kept)]
    traversals, earlier = TraversalTable(layout), PreviousTraversals(layout)
    try:
        for scene_id in inputs.scenes:
            if scene_id in kept:
                for row in earlier.rows_of(scene_id):
                    traversals.add(row)
                continue
            own = [(item, ledger[key]) for key, item in inputs.traversals.items() if item.scene_id == scene_id]
            derived = write_scene_tables(layout, scene_id, own, take)
            for name, file in derived.files.items():
                _publish(layout, f"{name}/{scene_id}.parquet", file, entries)
            groups.append(rows_to_table(derived.row_groups, ROW_GROUPS))
    except BaseException:
        traversals.abandon()
        raise
    _publish(layout, f"{TRAVERSALS.name}.parquet", traversals.finish(), entries)
    if previous is not None:
        entries.update({name: entry for name, entry in previous.files.items() if _scene_of(name) in kept})
    for name, data in encode_global(inputs, passes, traversals.rows, pa.concat_tables(groups)).items():
        _write(layout, f"{name}.parquet", data, entries)

    manifest = Manifest(derived_from=dict(sorted(inputs.fingerprints.items())), files=dict(sorted(entries.items())))
    write_json(layout.index / MANIFEST, manifest)
    _remove_strays(layout, manifest)
    release(layout)
    changed = tuple(scene_id for scene_id in inputs.scenes if scene_id not in kept)
    return IndexReport(changed, tuple(sorted(kept)), _rows(layout), time.perf_counter() - start)


def _require_whole(layout: Layout, inputs: Inputs) -> None:
    """Every table that was recorded has the size that its manifest says; nothing is read."""
    for key, item in inputs.traversals.items():
        for name, entry in item.recorded.files.items():
            path = layout.recorded(key) / name
            there = path.stat().st_size if path.is_file() else None
            if there != entry.bytes:
                raise DatasetError(
                    "missing" if there is None else f"has {there:,} bytes: it is cut off, or was changed",
                    file=path,
                    expected=f"{entry.bytes:,} bytes, as its manifest says",
                    remedy=f"run the same `mirror ingest` again for drive {item.drive.drive_id}; "
                    "`mirror check` lists all that is broken",
                )


def _intact_manifest(layout: Layout) -> Manifest | None:
    """The manifest of the index that is there, if all its files are, byte for byte."""
    try:
        manifest = read_manifest(layout.index)
    except SchemaError:
        # The index is derived: what cannot be read is made again.
        return None
    if manifest is None:
        return None
    for name, entry in manifest.files.items():
        path = layout.index / name
        if not path.is_file() or path.stat().st_size != entry.bytes or sha256_bytes(path.read_bytes()) != entry.sha256:
            return None
    return manifest


def _unchanged(previous: Manifest | None, inputs: Inputs) -> frozenset[str]:
    if previous is None:
        return frozenset()
    return frozenset(
        scene_id
        for scene_id in inputs.scenes
        if previous.derived_from.get(f"scene:{scene_id}") == inputs.fingerprints[f"scene:{scene_id}"]
    )


def _kept_row_groups(layout: Layout, kept: frozenset[str]) -> pa.Table:
    if not kept:
        return plain_schema(ROW_GROUPS).empty_table()
    data = read_table(layout.index / f"{ROW_GROUPS.name}.parquet", ROW_GROUPS)
    data = data.cast(plain_schema(ROW_GROUPS)).replace_schema_metadata(None)
    return data.filter(pc.is_in(data.column("scene_id"), value_set=pa.array(sorted(kept))))


def _write(layout: Layout, name: str, data: bytes, entries: dict[str, FileEntry]) -> None:
    supersede(layout, layout.index / name)
    write_bytes(layout.index / name, data)
    entries[name] = FileEntry(bytes=len(data), sha256=sha256_bytes(data))


def _publish(layout: Layout, name: str, file: Path, entries: dict[str, FileEntry]) -> None:
    """Put a complete file in the place of the one that readers of this generation go on reading."""
    with file.open("rb") as opened:
        entries[name] = FileEntry(bytes=file.stat().st_size, sha256=hashlib.file_digest(opened, "sha256").hexdigest())
    supersede(layout, layout.index / name)
    try:
        file.rename(layout.index / name)
    except OSError as error:
        file.unlink(missing_ok=True)
        raise unwritable_error(layout.index / name, error) from error


def _scene_of(name: str) -> str | None:
    folder, _, file = name.rpartition("/")
    return file.removesuffix(".parquet") if folder else None


def _remove_strays(layout: Layout, manifest: Manifest) -> None:
    """Remove the tables of scenes that are gone, and what an interrupted run left."""
    expected = {layout.index / name for name in (*manifest.files, MANIFEST)}
    for path in sorted(layout.index.rglob("*")):
        if path.is_file() and path not in expected:
            supersede(layout, path)


def _rows(layout: Layout) -> dict[str, int]:
    import pyarrow.parquet as pq

    rows = {table.name: 0 for table in INDEX_BY_SCENE}
    groups = read_table(layout.index / f"{ROW_GROUPS.name}.parquet", ROW_GROUPS, ["table", "rows"])
    for group in groups.to_pylist():
        rows[group["table"]] += group["rows"]
    files = (layout.index / f"{name}.parquet" for name in ("scenes", "traversals", "passes"))
    return {**{file.stem: pq.read_metadata(file).num_rows for file in files}, **rows}
