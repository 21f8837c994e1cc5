"""Writing one segment of the index: tables of some drives, in a folder that is named after their content."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from mirror.dataset.destination import Destination, FolderDestination
from mirror.dataset.index.global_tables import accepted_passes, encode_global, read_passes, rows_to_table
from mirror.dataset.index.inputs import IndexInputs
from mirror.dataset.index.scene_tables import write_scene_tables
from mirror.dataset.index.traversal_table import TraversalTable
from mirror.dataset.layout import MANIFEST, Layout, is_intact
from mirror.dataset.owned_folder import OwnedFolder, abandoned_folders
from mirror.dataset.store import Store
from mirror.schema.commit import ConflictError
from mirror.schema.documents import FileEntry, Manifest
from mirror.schema.files import parse_json, sha256_bytes, unwritable_error, write_bytes, write_json
from mirror.schema.index_tables import ROW_GROUPS, TRAVERSALS
from mirror.schema.snapshot import SOURCES, IndexSegment

WORK: Final = ".segment"
_NAME_DIGITS: Final = 16


def write_segment(
    layout: Layout,
    inputs: IndexInputs,
    add: Callable[[], None] = lambda: None,
    *,
    repair: bool = False,
    destination: Destination | None = None,
) -> IndexSegment:
    """Derive the tables of some drives and scenes, and commit them as a segment.

    The bytes are a pure function of the inputs. The tables are made in a folder of this call alone; an equal segment of
    another writer counts as done.

    Args:
        layout: a folder with those drives, in which the tables are made.
        inputs: of those drives and scenes.
        add: called after each traversal.
        destination: where the segment is committed; None: in the folder.
        repair: make an equal segment again whose files were damaged; the caller holds the dataset's writer lock.

    Raises:
        ConflictError: there is such a segment with other bytes, and it is not to be repaired.
        DatasetError: a file is missing or differs from the one in a manifest, or the dataset cannot be written.
        SchemaError: a file is broken or has another schema version.
    """
    place = FolderDestination(layout.root) if destination is None else destination
    for abandoned in abandoned_folders(layout.index, WORK):
        shutil.rmtree(abandoned, ignore_errors=True)
    passes = read_passes(layout, inputs)
    ledger = accepted_passes(passes)
    created = not layout.index.exists()
    work = OwnedFolder(layout.index, WORK)
    try:
        entries: dict[str, FileEntry] = {}
        groups: list[Mapping[str, Any]] = []
        traversals = TraversalTable(work.path)

        def add_traversal(row: Mapping[str, Any]) -> None:
            traversals.add(row)
            add()

        try:
            for scene_id in sorted({one.scene_id for one in inputs.traversals.values()}):
                own = [(one, ledger[key]) for key, one in inputs.traversals.items() if one.scene_id == scene_id]
                derived = write_scene_tables(layout, work.path, scene_id, own, add_traversal)
                for name, file in derived.files.items():
                    entries[f"{name}/{scene_id}.parquet"] = _place(file, work.path / name / f"{scene_id}.parquet")
                groups += derived.row_groups
        except BaseException:
            traversals.abandon()
            raise
        name = f"{TRAVERSALS.name}.parquet"
        entries[name] = _place(traversals.finish(), work.path / name)
        tables = encode_global(inputs, passes, traversals.rows, rows_to_table(groups, ROW_GROUPS))
        for table, data in tables.items():
            write_bytes(work.path / f"{table}.parquet", data)
            entries[f"{table}.parquet"] = FileEntry(bytes=len(data), sha256=sha256_bytes(data))
        # Not among the manifest's files: the tables of equal drives have one name, whatever the hashes are called.
        sources = json.dumps(inputs.sources.model_dump(mode="json"), ensure_ascii=False, sort_keys=True).encode()
        write_bytes(work.path / SOURCES, sources)
        manifest = Manifest(derived_from=dict(sorted(inputs.fingerprints.items())), files=dict(sorted(entries.items())))
        write_json(work.path / MANIFEST, manifest)
        sha256 = sha256_bytes((work.path / MANIFEST).read_bytes())
        segment = IndexSegment(
            name=sha256[:_NAME_DIGITS],
            manifest=sha256,
            sources=sha256_bytes(sources),
            drives=tuple(sorted(inputs.drives)),
            scenes=tuple(sorted(inputs.scenes)),
        )
        try:
            place.commit_folder(work.path, f"index/{segment.name}", MANIFEST)
        except ConflictError:
            if not repair:
                raise
            shutil.rmtree(layout.segment(segment.name))
            place.commit_folder(work.path, f"index/{segment.name}", MANIFEST)
        return segment
    finally:
        work.remove()
        if created and layout.index.exists() and not any(layout.index.iterdir()):
            layout.index.rmdir()


def is_segment_intact(store: Store, segment: IndexSegment) -> bool:
    """Return whether all files of a segment have their hashes; of a remote one, whether all are there, by their sizes.

    What is put into a store has all of its bytes, and none of it is put again.
    """
    folder = f"index/{segment.name}"
    found = store.read_many([f"{folder}/{name}" for name in (MANIFEST, SOURCES)])
    if [sha256_bytes(data) for data in found.values()] != [segment.manifest, segment.sources]:
        return False
    if store.folder is not None:
        return is_intact(Path(store.folder, folder))
    manifest = parse_json(found[f"{folder}/{MANIFEST}"], Manifest, store.full_path(f"{folder}/{MANIFEST}"))
    listed = store.list_tree(folder)
    sizes = {name: listed[path].bytes for name in manifest.files if (path := f"{folder}/{name}") in listed}
    return sizes == {name: entry.bytes for name, entry in manifest.files.items()}


def _place(file: Path, path: Path) -> FileEntry:
    """Give a complete file its name in the work folder."""
    with file.open("rb") as opened:
        digest = hashlib.file_digest(opened, "sha256").hexdigest()
    try:
        file.rename(path)
    except OSError as error:
        file.unlink(missing_ok=True)
        raise unwritable_error(path, error) from error
    return FileEntry(bytes=path.stat().st_size, sha256=digest)
