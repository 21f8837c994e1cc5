"""Auditing of what is already out: a bundle, release, export, model or page, held against the dataset it came from."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mirror.dataset import open as open_dataset
from mirror.dataset.door.files import DatasetFiles, ImageKey, list_dataset_files
from mirror.dataset.door.inspection import Leak, SameBytes, inspect_files
from mirror.dataset.door.placing import hash_file
from mirror.dataset.door.plan import Departure, plan_departure
from mirror.dataset.door.secrets import Secrets, describe
from mirror.dataset.layout import Layout, require_dataset
from mirror.dataset.split_document import read_split
from mirror.dataset.store import Store
from mirror.errors import DatasetError, ExitCode
from mirror.export.publish import DATASET_FOLDERS, withheld_images
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.document import Protocol
from mirror.schema.bundle import BUNDLE, Bundle
from mirror.schema.links import refuse_links_out, require_inside

_OWN: Final = ("index/",)
"""Files that a bundle derives from its others."""


@dataclass(frozen=True, eq=False)
class AuditReport:
    """The result of an audit.

    Attributes:
        files: number of files that were read.
        leaks: files that must not be out, and why.
        same_bytes: images that are out with the bytes of images that must not be.
    """

    files: int
    leaks: Sequence[Leak]
    same_bytes: Sequence[SameBytes]

    def exit_code(self) -> ExitCode:
        """Return the exit code of `mirror dataset audit`."""
        return ExitCode.FINDINGS if self.leaks else ExitCode.DONE


def audit(
    url: str,
    root: Path,
    *,
    split: str | None = None,
    protocols: Sequence[Protocol] = (),
    progress: ProgressReporter | None = None,
) -> AuditReport:
    """Search a published dataset for content of its source that must not be out. Nothing is changed.

    Of a bundle, every file must be one that publishing the dataset would copy, and every image must have the bytes that
    it has in the dataset. Any other folder is searched for images that must not leave.

    Args:
        url: folder or URL of a bundle, or a folder with a release, an export, a model or pages.
        root: folder of the complete dataset.
        split: the split whose held-out traversals are withheld; None: that of the bundle, if it is one.
        protocols: protocols whose truth is withheld, besides the images that the bundle states as withheld.
        progress: receives the progress.

    Raises:
        DatasetError: one of them does not exist, the split does not exist, or a link leads out of one of them.
        SchemaError: a document is broken.
    """
    reporter = progress or NullProgress()
    layout, store = Layout(root), Store(url)
    require_dataset(layout)
    bundle = _read_bundle(store)
    names = _list_names(store, bundle)
    if not names:
        raise DatasetError("the folder is empty", file=store.root, expected="what was published")
    files = list_dataset_files(layout)
    departure = plan_departure(files, _withheld(layout, files, bundle, split, protocols))
    dataset = open_dataset(layout.root)
    secrets = Secrets(dataset.store, departure, reporter)
    shown = {one.name for one in departure.shown.values()}
    stated = {} if bundle is None else {name: _source_hash(layout, departure, name) for name in names if name in shown}
    inspection = inspect_files(store.read, names, departure, secrets, reporter, stated=stated)
    leaks = list(inspection.leaks)
    if bundle is not None:
        found = {one.file for one in leaks}
        leaks += [one for one in _unnamed(names, departure, files) if one.file not in found]
    return AuditReport(len(names), tuple(sorted(leaks)), inspection.same_bytes)


def _read_bundle(store: Store) -> Bundle | None:
    try:
        store.read(BUNDLE)
    except (FileNotFoundError, NotADirectoryError):
        if store.folder is None or not store.folder.is_dir():
            raise DatasetError(
                f"no {BUNDLE} here", file=store.root, expected="a published dataset, or a folder of this machine",
                remedy="check the address",
            ) from None  # fmt: skip
        return None
    return store.json(BUNDLE, Bundle)


def _list_names(store: Store, bundle: Bundle | None) -> list[str]:
    """Every file: of a folder all that lie in it, of a URL those that its document lists."""
    listed = set() if bundle is None else {*bundle.files}
    if store.folder is not None:
        refuse_links_out(store.folder)
        listed |= {
            Path(folder, name).relative_to(store.folder).as_posix()
            for folder, _, names in os.walk(store.folder)
            for name in names
        }
    return sorted(listed)


def _withheld(
    layout: Layout, files: DatasetFiles, bundle: Bundle | None, split: str | None, protocols: Sequence[Protocol]
) -> Callable[[ImageKey], bool]:
    """Return whether an image must not be out: by the bundle's own list, by the split, and by the protocols."""
    paths = frozenset() if bundle is None else frozenset(bundle.withheld)
    listed = {one.key for one in files.images if one.name in paths}
    chosen = split if split is not None or bundle is None else bundle.split
    if chosen is None:
        return lambda key: key in listed
    dataset = open_dataset(layout.root)
    by_split = withheld_images(dataset, read_split(dataset.store, chosen), protocols)
    return lambda key: key in listed or by_split(key)


def _source_hash(layout: Layout, departure: Departure, name: str) -> str:
    path = require_inside(layout.root, name)
    return hash_file(path) if path.is_file() else departure.files[name] or ""


def _unnamed(names: Sequence[str], departure: Departure, files: DatasetFiles) -> list[Leak]:
    """Files in the folders of a dataset that publishing would not copy."""
    kept = {one.file.name: one for one in departure.kept}
    found = []
    for name in names:
        inside = name.partition("/")[0] in DATASET_FOLDERS and not name.startswith(_OWN)
        if not inside or name in departure.files:
            continue
        if name in kept:
            found.append(Leak(name, f"the place of {kept[name].why.value}: {describe(kept[name].file)}"))
        elif name in files.names:
            found.append(Leak(name, "a layer that does not leave"))
        else:
            found.append(Leak(name, "a file that no document or table of the dataset names"))
    return found
