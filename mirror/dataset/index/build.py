"""Building the index. Only scenes with changed inputs are derived; the manifest is written last."""

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
from mirror.dataset.index.inputs import IndexInputs, read_inputs
from mirror.dataset.index.scene_tables import plain_schema, write_scene_tables
from mirror.dataset.index.traversal_table import PreviousTraversals, TraversalTable
from mirror.dataset.layout import MANIFEST, Layout, read_manifest
from mirror.dataset.store import Store
from mirror.errors import DatasetError, SchemaError
from mirror.schema.documents import DatasetDocument, FileEntry, Manifest
from mirror.schema.files import read_json, read_table, sha256_bytes, unwritable_error, write_bytes, write_json
from mirror.schema.index_tables import INDEX_BY_SCENE, ROW_GROUPS, TRAVERSALS

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class IndexReport:
    """The result of building the index.

    Attributes:
        scenes_written: scenes with newly derived tables.
        scenes_kept: scenes without changed inputs.
        rows: number of rows in the index, by table.
        seconds: duration of the build.
    """

    scenes_written: tuple[str, ...]
    scenes_kept: tuple[str, ...]
    rows: Mapping[str, int]
    seconds: float


def build_index(
    root: str | Path, *, force: bool = False, check_sizes: bool = False, progress: Progress | None = None
) -> IndexReport:
    """Derive the index tables that are not current, and keep the others.

    The bytes are a pure function of the rest of the dataset and do not depend on the order of ingest. The caller holds
    the dataset's writer lock.

    Args:
        root: the dataset's folder.
        force: derive every scene again.
        check_sizes: compare the sizes of all recorded tables with their manifests, also in scenes that are kept.
        progress: called with the number of traversals that are done and the total.

    Raises:
        DatasetError: the folder holds no dataset, or a file is missing or differs from the one in a manifest.
        SchemaError: a file is broken or has another schema version.
    """
    start = time.perf_counter()
    layout = Layout(Path(root))
    recover(layout)
    read_json(layout.document, DatasetDocument)
    inputs = read_inputs(Store(layout.root))
    if check_sizes:
        _require_recorded_sizes(layout, inputs)
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

    def add_traversal(row: Mapping[str, Any]) -> None:
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
            derived = write_scene_tables(layout, scene_id, own, add_traversal)
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


def _require_recorded_sizes(layout: Layout, inputs: IndexInputs) -> None:
    """Raise an error if the size of a recorded table differs from its manifest. No table is read."""
    for key, item in inputs.traversals.items():
        for name, entry in item.recorded.files.items():
            path = layout.recorded(key) / name
            size = path.stat().st_size if path.is_file() else None
            if size != entry.bytes:
                raise DatasetError(
                    "missing" if size is None else f"has {size:,} bytes: it is cut off, or was changed",
                    file=path,
                    expected=f"{entry.bytes:,} bytes, as its manifest says",
                    remedy=f"run the same `mirror ingest` again for drive {item.drive.drive_id}; "
                    "`mirror check` lists all that is broken",
                )


def _intact_manifest(layout: Layout) -> Manifest | None:
    """The manifest of the existing index, if all its files have their hashes; else None."""
    try:
        manifest = read_manifest(layout.index)
    except SchemaError:
        # The index is derived: an unreadable one is built again.
        return None
    if manifest is None:
        return None
    for name, entry in manifest.files.items():
        path = layout.index / name
        if not path.is_file() or path.stat().st_size != entry.bytes or sha256_bytes(path.read_bytes()) != entry.sha256:
            return None
    return manifest


def _unchanged(previous: Manifest | None, inputs: IndexInputs) -> frozenset[str]:
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
    """Move a complete file to its place; the superseded one stays available to readers of its generation."""
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
    """Remove tables of scenes that no longer exist, and files of an interrupted run."""
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
