"""Migration of datasets of earlier versions, whose index has one file a table and scene and no snapshots."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mirror.dataset.destination import FolderDestination
from mirror.dataset.generation import FOLDER as SUPERSEDED
from mirror.dataset.generation import recover
from mirror.dataset.index.build import IndexReport, build_index
from mirror.dataset.layout import MANIFEST, Layout, require_dataset
from mirror.dataset.lease import hold_lease
from mirror.dataset.lock import replacing, writer_lock
from mirror.errors import SchemaError, UsageError
from mirror.schema.bundle import BUNDLE
from mirror.schema.files import write_json
from mirror.schema.index_tables import INDEX_BY_SCENE, INDEX_GLOBAL
from mirror.schema.strict_json import JsonError, decode_json
from mirror.schema.version import DATASET_VERSION, require_readable

_STAGING: Final = ".staging"


@dataclass(frozen=True)
class MigrationReport:
    """The result of a migration.

    Attributes:
        before: the dataset's version before; that of today: there was nothing to do.
        index: the result of building the index; None: there was nothing to do.
    """

    before: str
    index: IndexReport | None


def migrate(root: Path, *, wait: bool = False) -> MigrationReport:
    """Give a dataset of an earlier version an index with snapshots, and today's version.

    Drives, traversals, layers, maps and splits stay byte for byte. The earlier index is removed at the end: an
    interrupted migration is continued by the same call.

    Args:
        root: the dataset's folder.
        wait: wait for another run that writes the dataset.

    Raises:
        UsageError: the folder is a published dataset, whose files are sealed.
        DatasetError: there is no dataset, a file is missing or damaged, another run holds the dataset's lease, or it
            cannot be written.
        SchemaError: a document is broken, or of a later version.
    """
    layout = Layout(root)
    require_dataset(layout)
    if (root / BUNDLE).is_file():
        raise UsageError(
            "a published dataset is sealed by the hashes of its files", file=root / BUNDLE,
            expected="the dataset that it was published from",
            remedy="let its publisher migrate that, and publish it again with `mirror dataset publish`",
        )  # fmt: skip
    with hold_lease(FolderDestination(root), "migrate", wait=wait) as lease, writer_lock(layout, wait=wait):
        document = _read_document(layout.document)
        before = str(document["schema_version"])
        is_earlier = before.split(".")[:2] != DATASET_VERSION.split(".")[:2]
        if not is_earlier and not (layout.index / MANIFEST).exists():
            return MigrationReport(before, None)
        lease.require()
        if is_earlier:
            with replacing(layout):
                # What an interrupted run of the earlier version had moved comes back first.
                recover(layout)
            write_json(layout.document, {**document, "schema_version": DATASET_VERSION})
        report = build_index(root, compact=True)
        lease.require()
        _remove_earlier(layout)
        return MigrationReport(before, report)


def _read_document(path: Path) -> dict[str, Any]:
    try:
        document = decode_json(path.read_bytes())
    except JsonError as error:
        raise SchemaError(str(error), file=path, place=error.place, remedy="restore the file") from error
    if not isinstance(document, dict):
        raise SchemaError("not an object", file=path, expected="the document of a dataset", remedy="restore the file")
    require_readable(document.get("schema_version"), path, DATASET_VERSION)
    return document


def _remove_earlier(layout: Layout) -> None:
    """Remove the earlier index, its superseded files, and unfinished runs: their work is done again."""
    (layout.index / MANIFEST).unlink(missing_ok=True)
    for table in INDEX_GLOBAL:
        (layout.index / f"{table.name}.parquet").unlink(missing_ok=True)
    for table in INDEX_BY_SCENE:
        shutil.rmtree(layout.index / table.name, ignore_errors=True)
    for layer in sorted((layout.root / SUPERSEDED).glob("*.*")):
        if not layer.name.partition(".")[2].isdigit():
            shutil.rmtree(layer, ignore_errors=True)
    for folder in (layout.root / SUPERSEDED, layout.root / _STAGING):
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
