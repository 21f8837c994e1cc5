"""Building the index: what changed is derived into a segment, and a snapshot with it is put last."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from mirror.dataset.destination import BucketDestination, Destination, FolderDestination
from mirror.dataset.generation import recover, release
from mirror.dataset.index.inputs import IndexInputs, read_inputs
from mirror.dataset.index.segment import is_segment_intact, write_segment
from mirror.dataset.index.snapshots import (
    IndexState,
    list_snapshots,
    newest_segments,
    put_snapshot,
    read_snapshot,
    read_state,
)
from mirror.dataset.index.table_copy import copy_drives
from mirror.dataset.layout import Layout
from mirror.dataset.store import Store
from mirror.errors import DatasetError, SchemaError
from mirror.schema.commit import ConflictError
from mirror.schema.documents import DatasetDocument
from mirror.schema.files import read_json
from mirror.schema.index_tables import INDEX_BY_SCENE, INDEX_PASSES, ROW_GROUPS, TRAVERSALS
from mirror.schema.snapshot import DriveSource, IndexSegment, SegmentSources
from mirror.schema.tables import Table

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class IndexReport:
    """The result of building the index.

    Attributes:
        snapshot: number of the newest snapshot.
        segments: number of its segments.
        scenes_written: scenes with newly derived rows.
        scenes_kept: scenes without changed inputs.
        rows: number of rows in the index, by table.
        seconds: duration of the build.
    """

    snapshot: int
    segments: int
    scenes_written: tuple[str, ...]
    scenes_kept: tuple[str, ...]
    rows: Mapping[str, int]
    seconds: float


@dataclass(frozen=True)
class IndexChanges:
    """The difference of an index from its inputs.

    Attributes:
        drives: new drives, and drives with changed inputs.
        scenes: new and changed scenes.
        maps: new and changed maps.
        without_drives: drives that are gone.
        without_scenes: scenes that are gone.
        without_maps: scenes whose map is gone.
        loses_rows: files of the index's rows have been replaced or removed.
    """

    drives: frozenset[str]
    scenes: frozenset[str]
    maps: frozenset[str]
    without_drives: frozenset[str] = frozenset()
    without_scenes: frozenset[str] = frozenset()
    without_maps: frozenset[str] = frozenset()
    loses_rows: bool = False

    def __bool__(self) -> bool:
        return bool(self.drives or self.scenes or self.maps or self.without_drives or self.without_scenes) or bool(
            self.without_maps
        )


def build_index(
    root: str | Path,
    *,
    force: bool = False,
    compact: bool = False,
    check_sizes: bool = False,
    progress: Progress | None = None,
) -> IndexReport:
    """Derive the rows whose inputs have changed since the newest snapshot, and put the next snapshot.

    A first, a forced and a compact build have one segment, whose bytes are a pure function of the rest of the dataset
    and do not depend on the order of ingest. The caller holds the dataset's writer lock.

    Args:
        root: the dataset's folder.
        force: derive everything again.
        compact: derive everything again, unless the newest snapshot has one segment that is whole and up to date.
        check_sizes: compare the sizes of all recorded tables with their manifests, also of drives that are kept.
        progress: called with the number of traversals that are done and the total.

    Raises:
        DatasetError: the folder holds no dataset, or a file is missing or differs from the one in a manifest.
        SchemaError: a file is broken or has another schema version.
    """
    start = time.perf_counter()
    layout = Layout(Path(root))
    recover(layout)
    read_json(layout.document, DatasetDocument)
    if check_sizes:
        _require_recorded_sizes(layout, read_inputs(Store(layout.root)))
    built = _build(FolderDestination(layout.root), layout, force=force, compact=compact, progress=progress)
    release(layout)
    return _report(Store(layout.root), *built, start)


def build_bucket_index(
    destination: BucketDestination, *, force: bool = False, compact: bool = False, progress: Progress | None = None
) -> IndexReport:
    """Derive the index of a dataset in a bucket, as `build_index` does, and put the next snapshot.

    The tables of the drives whose rows are derived are copied into a folder of this machine first; images are not.
    Others may write the bucket meanwhile.

    Args:
        destination: the dataset.
        force: derive everything again.
        compact: derive everything again, unless the newest snapshot has one segment that is whole and up to date.
        progress: called with the number of traversals that are done and the total.

    Raises:
        DatasetError: there is no dataset, or an object is missing or damaged, or cannot be written.
        SchemaError: an object is broken or has another schema version.
    """
    start = time.perf_counter()
    store = destination.store
    store.json("dataset.json", DatasetDocument)
    with tempfile.TemporaryDirectory(prefix="mirror-index-") as folder:
        try:
            built = _build(destination, Layout(Path(folder)), force=force, compact=compact, progress=progress)
        except ConflictError as error:
            segment = "/".join(str(error.file).removeprefix(f"{destination.url}/").split("/")[:2])
            raise DatasetError(
                "a segment of the index is damaged", file=error.file, expected="the bytes that its name stands for",
                remedy=f"remove {segment}/ in the bucket, and run `mirror index {destination.url}` again",
            ) from error  # fmt: skip
    return _report(store, *built, start)


def _build(
    place: Destination, layout: Layout, *, force: bool, compact: bool, progress: Progress | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Derive what changed, and put the next snapshot.

    Args:
        place: the dataset.
        layout: its folder; of a bucket, a folder of this machine, into which tables are copied.
        force: derive everything again.
        compact: see `build_index`.
        progress: see `build_index`.

    Returns:
        The scenes with newly derived rows, and the others.
    """
    store = place.store
    state = _intact_state(store)
    known = newest_segments(store)
    inputs = read_inputs(store)
    changes = None if state is None else find_changes(state.sources, inputs)
    is_whole = force or state is None or (compact and (bool(changes) or not _is_compact(state)))
    # A segment cannot say that a map is gone.
    is_whole = is_whole or bool(changes is not None and changes.without_maps)
    if changes is not None and not changes and not is_whole:
        return (), tuple(inputs.scenes)
    if changes is None or is_whole:
        loses = bool(known) if changes is None else changes.loses_rows
        maps = frozenset(inputs.map_hashes)
        changes = IndexChanges(frozenset(inputs.drives), frozenset(inputs.scenes), maps, loses_rows=loses)
    part = inputs.part(changes.drives, changes.scenes, changes.maps)
    count, to_do = 0, len(part.traversals)

    def add() -> None:
        nonlocal count
        count += 1
        if progress is not None:
            progress(count, to_do)

    if store.folder is None:
        copy_drives(store, layout, part.drives)
    segment = write_segment(layout, part, add, repair=store.folder is not None, destination=place)
    put_snapshot(
        place,
        segment,
        without_segments=known if is_whole else frozenset(),
        without_drives=changes.without_drives,
        without_scenes=changes.without_scenes,
        loses_rows=changes.loses_rows,
    )
    written = {one.scene_id for one in part.traversals.values()} | changes.scenes
    return tuple(sorted(written)), tuple(scene_id for scene_id in inputs.scenes if scene_id not in written)


def append_drives(
    layout: Layout, drives: Collection[str], found: Collection[str] = (), *, destination: Destination | None = None
) -> int:
    """Add new drives to the index, and the scenes that it does not have. No other drive is opened, and no lock is held.

    Args:
        layout: the dataset; or a folder that has the drives, laid out like a dataset.
        drives: complete drives that this run committed.
        found: complete drives that it found: they are added if an interrupted run did not put its snapshot.
        destination: the dataset, if it is not the folder.

    Returns:
        The number of the newest snapshot.

    Raises:
        DatasetError: a file is missing or differs from the one in a manifest, or the index cannot be written.
        SchemaError: a file is broken.
    """
    place = FolderDestination(layout.root) if destination is None else destination
    store = place.store
    numbers = list_snapshots(store)
    known = read_snapshot(store, numbers[-1]) if numbers else None
    known_drives = {} if known is None else known.drives
    inputs = read_inputs(
        Store(layout.root), {*drives, *(drive_id for drive_id in found if drive_id not in known_drives)}
    )
    have = frozenset() if known is None else frozenset(known.scenes)
    part = inputs.part(inputs.drives, inputs.scenes.keys() - have)
    if known is not None and not part.drives and not part.scenes:
        return numbers[-1]
    try:
        return put_snapshot(place, write_segment(layout, part, destination=place))
    except ConflictError as error:
        raise DatasetError(
            "a segment of the index is damaged", file=error.file, expected="the file that its manifest names",
            remedy=f"run `mirror index {store.root}`, which also adds the drives of this run",
        ) from error  # fmt: skip


def find_changes(indexed: SegmentSources, inputs: IndexInputs) -> IndexChanges:
    """Find what differs between the sources of an index and the present inputs."""
    now = inputs.sources
    changed = frozenset(key for key, one in now.drives.items() if indexed.drives.get(key) != one)
    scenes = frozenset(key for key, value in now.scenes.items() if indexed.scenes.get(key) != value)
    maps = frozenset(key for key, value in now.maps.items() if indexed.maps.get(key) != value)
    gone = frozenset(indexed.drives.keys() - now.drives.keys())
    gone_scenes = frozenset(indexed.scenes.keys() - now.scenes.keys())
    if indexed.derivation != now.derivation and (indexed.drives or indexed.scenes):
        changed, scenes = frozenset(now.drives), frozenset(now.scenes)
    replaced = any(_loses_rows(indexed.drives[key], now.drives[key]) for key in changed if key in indexed.drives)
    loses = bool(gone) or replaced or any(key in indexed.maps for key in maps)
    gone_maps = frozenset(indexed.maps.keys() - now.maps.keys())
    return IndexChanges(changed, scenes, maps, gone, gone_scenes, gone_maps, loses or bool(gone_maps))


def describe_changes(changes: IndexChanges) -> list[str]:
    """Return the names of what changed, as ``kind:id``."""
    return [
        *(f"drive:{key}" for key in sorted(changes.drives | changes.without_drives)),
        *(f"scene:{key}" for key in sorted(changes.scenes | changes.without_scenes)),
        *(f"map:{key}" for key in sorted(changes.maps | changes.without_maps)),
    ]


def _loses_rows(before: DriveSource, after: DriveSource) -> bool:
    """Return whether folders that a drive's rows name were replaced or removed."""
    for name, hashes in before.traversals.items():
        now = after.traversals.get(name, {})
        if any(now.get(key) != value for key, value in hashes.items() if key.startswith(("recorded", "layer:"))):
            return True
    return False


def _is_compact(state: IndexState) -> bool:
    return len(state.snapshot.segments) == 1 and state.snapshot.segments[0].is_whole


def _intact_state(store: Store) -> IndexState | None:
    """The newest snapshot, if all files that it names have their hashes; else None."""
    try:
        state = read_state(store)
    except (SchemaError, DatasetError):
        # The index is derived: an unreadable one is built again.
        return None
    if state is None or not all(is_segment_intact(store, segment) for segment in state.snapshot.segments):
        return None
    return state


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
                    remedy=f"run the same `mirror ingest` again with --verify for drive {item.drive.drive_id}; "
                    "`mirror check` lists all that is broken",
                )


def _report(store: Store, written: tuple[str, ...], kept: tuple[str, ...], start: float) -> IndexReport:
    number = list_snapshots(store)[-1]
    snapshot = read_snapshot(store, number)
    rows = {"scenes": len(snapshot.scenes), TRAVERSALS.name: 0, INDEX_PASSES.name: 0}
    rows.update({table.name: 0 for table in INDEX_BY_SCENE})
    for segment in snapshot.segments:
        drives = frozenset(segment.drives)
        for table in (TRAVERSALS, INDEX_PASSES):
            rows[table.name] += sum(one["drive_id"] in drives for one in _rows(store, segment, table, ["drive_id"]))
        for group in _rows(store, segment, ROW_GROUPS, ["table", "traversal_id", "rows"]):
            # `scene.drive.entry_ms`, and ids have no full stops.
            if group["traversal_id"].split(".")[1] in drives:
                rows[group["table"]] += group["rows"]
    return IndexReport(number, len(snapshot.segments), written, kept, rows, time.perf_counter() - start)


def _rows(store: Store, segment: IndexSegment, table: Table, columns: list[str]) -> list[dict[str, Any]]:
    with store.open(f"index/{segment.name}/{table.name}.parquet") as file:
        rows: list[dict[str, Any]] = pq.read_table(file, columns=columns).to_pylist()
    return rows
