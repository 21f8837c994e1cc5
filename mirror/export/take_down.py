"""Taking images down from a published dataset, in its folder: their bytes, their rows, and its seal."""

from __future__ import annotations

import re
import shutil
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mirror.dataset import open as open_dataset
from mirror.dataset.destination import FolderDestination
from mirror.dataset.door.files import ImageKey
from mirror.dataset.door.placing import hash_file
from mirror.dataset.index.build import build_index
from mirror.dataset.layout import Layout
from mirror.dataset.lease import hold_lease
from mirror.dataset.lock import writer_lock
from mirror.dataset.store import Store
from mirror.dataset.take_down import list_places, purge_images
from mirror.dataset.taken_down import encode_public_take_downs, group_by_traversal, read_take_downs
from mirror.dataset.writing import is_to_be_indexed
from mirror.errors import DatasetError, UsageError
from mirror.export.croissant import Publication, write_croissant
from mirror.export.datasheet import write_datasheet
from mirror.export.publish import CROISSANT, DATASHEET, add_file
from mirror.schema.bundle import BUNDLE, PUBLISHING, Bundle
from mirror.schema.documents import FileEntry
from mirror.schema.files import encode_json, read_json, remove_temporaries, write_bytes
from mirror.schema.links import require_inside
from mirror.schema.strict_json import JsonError, decode_json
from mirror.schema.take_downs import TAKE_DOWNS, TakeDowns

_CONTACT: Final = re.compile(r"^## Contact\n\n(.+)$", re.MULTILINE)
_NO_CONTACT: Final = "Ask the publisher of this copy for the removal of data."


@dataclass(frozen=True)
class PublicationReport:
    """The result of a take-down in a published dataset, or what it would be.

    Attributes:
        folder: its folder.
        images: number of the images that it knows.
        purged: files that were removed, and archives in which images are zeros now, relative to the folder.
    """

    folder: str
    images: int
    purged: tuple[str, ...]


def require_publication(folder: Path) -> None:
    """Require that a folder is a published dataset.

    Raises:
        UsageError: it is not.
    """
    if not (folder / BUNDLE).is_file():
        raise UsageError(
            "not a published dataset", file=folder, place="--publication",
            expected="a folder that `mirror dataset publish` wrote",
            remedy="for a release there is `mirror release withdraw`; make exports, models and pages again",
        )  # fmt: skip


def take_down_published(
    folder: Path, take_downs: TakeDowns, images: Collection[ImageKey], *, dry_run: bool = False, wait: bool = False
) -> PublicationReport:
    """Take images down from a published dataset, and seal it again. The same call finishes an interrupted one.

    Its tables stay; its list of images that were taken down, its index, datasheet and Croissant metadata are new.

    Args:
        folder: the published dataset.
        take_downs: what was taken down from the dataset that it came from.
        images: which of those are taken down here.
        dry_run: report only.
        wait: wait for another run that writes it.

    Raises:
        UsageError: the folder is not a published dataset.
        DatasetError: another run writes it, or a file cannot be read or written.
        SchemaError: a document or table is broken.
    """
    require_publication(folder)
    layout = Layout(folder)
    here = {key for key in images if (layout.recorded(key[0]) / "images.parquet").is_file()}
    if dry_run or not here:
        return PublicationReport(str(folder), len(here), ())
    own = tuple(one for one in take_downs.images if one.key in here)
    gone = group_by_traversal(TakeDowns(images=own))
    with hold_lease(FolderDestination(folder), "take-down", wait=wait) as lease, writer_lock(layout, wait=wait):
        bundle = read_json(folder / BUNDLE, Bundle)
        write_bytes(folder / PUBLISHING, b"")
        remove_temporaries(folder)
        known = {one.key: one for one in (*own, *read_take_downs(Store(folder)).images)}
        listed = TakeDowns(images=tuple(known[key] for key in sorted(known)))
        _write(folder / TAKE_DOWNS, encode_public_take_downs(listed))
        purged = purge_images(layout, gone, originals=True, before_each=lease.require)
        if is_to_be_indexed(Store(folder)):
            lease.require()
            # A published dataset has one snapshot, and no history in which the rows would be.
            shutil.rmtree(layout.index, ignore_errors=True)
            build_index(folder)
        lease.require()
        _seal(folder, bundle, _named(layout, gone))
        (folder / PUBLISHING).unlink(missing_ok=True)
    return PublicationReport(str(folder), len(own), tuple(purged))


def _named(layout: Layout, gone: dict[str, frozenset[tuple[str, int]]]) -> set[str]:
    """Paths of all files in which the images may have been."""
    return {
        place.uri
        for traversal_id, keys in gone.items()
        for place in list_places(layout, traversal_id, {(traversal_id, *key) for key in keys})
    }


def _seal(folder: Path, bundle: Bundle, changed: set[str]) -> None:
    """Write the document of a published dataset for its present files."""
    dataset = open_dataset(folder)
    try:
        old: dict[str, Any] = decode_json((folder / CROISSANT).read_bytes())
    except JsonError as error:
        raise DatasetError(
            str(error), file=folder / CROISSANT, expected="the document that was published",
            remedy="publish the dataset again: `mirror dataset publish`",
        ) from error  # fmt: skip
    datasheet = (folder / DATASHEET).read_text()
    files = {name: entry for name, entry in bundle.files.items() if not name.startswith("index/")}
    index = (path.relative_to(folder).as_posix() for path in (folder / "index").rglob("*") if path.is_file())
    for name in sorted({*changed, *index, TAKE_DOWNS}):
        path = require_inside(folder, name)
        if path.is_file():
            files[name] = FileEntry(bytes=path.stat().st_size, sha256=hash_file(path))
        else:
            files.pop(name, None)
    for name in (CROISSANT, DATASHEET):
        files.pop(name, None)
    bundle = bundle.model_copy(update={"files": dict(sorted(files.items()))})
    # A withheld image has no file here, and one that was taken down no row.
    images = sorted({uri for uri in dataset.table("images", ["uri"]).column(0).to_pylist() if uri in files})
    creator, citation = old.get("creator"), str(old["citeAs"])
    publication = Publication(old.get("url"), creator["name"] if creator else None, old.get("datePublished"), citation)
    name = str(old["name"])
    contact = _CONTACT.search(datasheet)
    stated = None if contact is None or contact[1] == _NO_CONTACT else contact[1]
    bundle = add_file(
        folder, bundle, CROISSANT, write_croissant(dataset, bundle, images, name=name, publication=publication)
    )
    bundle = add_file(
        folder, bundle, DATASHEET, write_datasheet(dataset, bundle, name=name, contact=stated, images=images)
    )
    _write(folder / BUNDLE, encode_json(bundle))


def _write(path: Path, data: bytes) -> None:
    if not path.is_file() or path.read_bytes() != data:
        write_bytes(path, data)
