"""A copy of the documents and tables of a dataset, without images, such as the index of a bucket is derived from."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from mirror.dataset.index.inputs import IndexInputs, read_inputs
from mirror.dataset.index.snapshots import list_snapshots
from mirror.dataset.layout import MANIFEST, Layout, not_a_dataset_error, require_dataset
from mirror.dataset.store import Store, StoredFile
from mirror.errors import DatasetError, UsageError
from mirror.schema.files import write_bytes
from mirror.schema.snapshot import SNAPSHOTS, snapshot_path

PLAN: Final = ("dataset.json", "rois.geojson")
_OF_DRIVE: Final = (MANIFEST, "drive.json", "passes.parquet")
_TABLES: Final = (".parquet", ".json")
_DOCUMENTS: Final = (".json", ".jsonl")
_FOLDERS: Final = ("drives", "rigs", "maps", "splits", "index")
_AT_A_TIME: Final = 256
"""Files that are held in memory on their way."""


def copy_drives(store: Store, layout: Layout, drives: Collection[str]) -> IndexInputs:
    """Copy the documents and tables that the rows of some drives are derived from, and the scenes and rigs.

    Args:
        store: the dataset.
        layout: a folder of this machine, laid out like a dataset.
        drives: complete drives.

    Returns:
        What the index derives from them.

    Raises:
        DatasetError: a file is missing, or a traversal is not the one that its drive was written with.
        SchemaError: a document is broken.
    """
    inputs = read_inputs(store, drives)
    names = [*PLAN, *(f"drives/{drive_id}/{name}" for drive_id in inputs.drives for name in _OF_DRIVE)]
    for traversal_id, item in inputs.traversals.items():
        folder = f"traversals/{traversal_id}"
        names += [f"{folder}/recorded/{name}" for name in (MANIFEST, *item.recorded.files)]
        for kind, source, version in item.layers:
            layer = f"{folder}/layers/{kind}/{source}@{version}"
            names += [f"{layer}/{name}" for name in store.list_files(layer) if name.endswith(_TABLES)]
    rigs = {item.drive.rig_id for item in inputs.traversals.values() if item.drive.rig_id is not None}
    copy_files(store, layout, [*names, *(f"rigs/{rig_id}.json" for rig_id in sorted(rigs))])
    return inputs


@dataclass(frozen=True)
class TableCopy:
    """The documents and tables of a dataset on this machine.

    Attributes:
        layout: the folder with them.
        files: all files of the dataset where it lies, by path; empty: it lies in the folder.
        store: the dataset where it lies.
    """

    layout: Layout
    files: Mapping[str, StoredFile]
    store: Store

    def name(self, text: str) -> str:
        """Return a message with the place where the dataset lies in place of the folder."""
        return text if self.store.folder is not None else text.replace(str(self.layout.root), self.store.root)


@contextmanager
def local_tables(root: str | Path, *, tables: bool = True) -> Iterator[TableCopy]:
    """Give the documents and tables of a dataset as files of this machine.

    Of a URL, they are copied into a folder that is removed at the end, with the newest snapshot of the index. The other
    files, such as images, stay where they are; their folders are made, so that it shows which there are.

    Args:
        root: the dataset's folder or URL.
        tables: False: of the folders of traversals, bring the documents only.

    Raises:
        DatasetError: there is no dataset.
        UsageError: the URL cannot be opened, or its store does not list its files.
    """
    store = Store(root)
    if store.folder is not None:
        layout = Layout(Path(root))
        require_dataset(layout)
        yield TableCopy(layout, {}, store)
        return
    files = store.list_tree("")
    if PLAN[0] not in files:
        if store.read_many([PLAN[0]]):
            raise UsageError(
                "this store does not list its files", file=store.root, expected="a folder, or a bucket",
                remedy=f"bring it to this machine: mirror dataset fetch {store.root} --out FOLDER",
            )  # fmt: skip
        raise not_a_dataset_error(store.root, exists=True)
    with tempfile.TemporaryDirectory(prefix="mirror-tables-") as folder:
        layout = Layout(Path(folder))
        for parent in sorted({PurePosixPath(name).parent for name in files}):
            (layout.root / parent).mkdir(parents=True, exist_ok=True)
        copy_files(store, layout, _small_files(store, files, tables=tables))
        yield TableCopy(layout, files, store)


def _small_files(store: Store, files: Collection[str], *, tables: bool) -> Iterator[str]:
    numbers = list_snapshots(store)
    newest = {snapshot_path(number) for number in numbers[-1:]}
    for name in files:
        folder, _, rest = name.partition("/")
        if folder == "traversals":
            wanted = name.endswith((*_DOCUMENTS, *((".parquet",) if tables else ())))
        elif name.startswith(f"{SNAPSHOTS}/"):
            wanted = name in newest
        else:
            # Failures and the lease are no part of what is checked.
            wanted = folder in _FOLDERS or not rest
        if wanted and not PurePosixPath(name).name.startswith("."):
            yield name


def copy_files(store: Store, layout: Layout, names: Iterable[str]) -> None:
    """Copy files to the same names below a folder.

    Raises:
        DatasetError: one is missing, or cannot be written.
    """
    listed = list(dict.fromkeys(names))
    for start in range(0, len(listed), _AT_A_TIME):
        some = listed[start : start + _AT_A_TIME]
        found = store.read_many(some)
        for name in some:
            if name not in found:
                raise DatasetError(
                    "missing", file=store.full_path(name), expected="a file that a manifest lists",
                    remedy="restore it, or ingest the recording again into a new place",
                )  # fmt: skip
            write_bytes(layout.root / name, found[name])
