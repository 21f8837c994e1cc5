"""Ingest into a bucket: drives are made in a folder of this machine, and committed one by one.

The plan, that is the dataset's document and its scenes, is committed before any drive. A drive's images leave this
machine as soon as the drive is complete, so that the folder holds the drives that are on their way, and the tables of
those that are done: the index is derived from them at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mirror.dataset.destination import BucketDestination
from mirror.dataset.index import append_drives
from mirror.dataset.index.table_copy import copy_drives
from mirror.dataset.layout import Layout, complete_manifest
from mirror.errors import DatasetError, UsageError
from mirror.ingest.request import IngestOptions
from mirror.ingest.rois import write_rois
from mirror.ingest.settings import IngestSettings
from mirror.ingest.staging import Staging, commit_drive
from mirror.schema.files import write_bytes, write_json

_PLAN = ("dataset.json", "rois.geojson")
_CREATED = "give all scenes and thresholds when the dataset is made, or ingest into a new place"


class BucketStaging(Staging):
    """The folder of a run that writes a bucket.

    Args:
        scratch: an empty folder of this machine.
        destination: the dataset.
    """

    def __init__(self, scratch: Layout, destination: BucketDestination) -> None:
        super().__init__(scratch)
        self.destination = destination
        self.drives: list[str] = []
        # The index is derived from this folder.
        for name in _PLAN:
            write_bytes(self.layout.root / name, (scratch.root / name).read_bytes())
        for rig in (scratch.root / "rigs").glob("*.json"):
            write_bytes(self.layout.root / "rigs" / rig.name, rig.read_bytes())

    def take(self, drive_id: str) -> None:
        """Commit a sealed drive, and remove its images from this machine.

        Raises:
            ConflictError: an object is there with other bytes.
            DatasetError: the bucket cannot be written.
        """
        commit_drive(self.layout, drive_id, self.destination)
        self.drives.append(drive_id)
        for traversal in (self.layout.root / "traversals").glob(f"*.{drive_id}.*"):
            _remove_images(traversal / "recorded")

    def append(self) -> None:
        """Add the committed drives to the index.

        Raises:
            DatasetError: the bucket cannot be written.
        """
        append_drives(self.layout, self.drives, destination=self.destination)


def fetch_plan(destination: BucketDestination, scratch: Layout) -> None:
    """Bring the document, the scenes and the rigs of a dataset into a folder; nothing where there is no dataset.

    Raises:
        DatasetError: the dataset is there without its scenes.
    """
    store = destination.store
    found = store.read_many(list(_PLAN))
    if _PLAN[0] not in found:
        # An interrupted run may have put the scenes, which come first.
        return
    if len(found) < len(_PLAN):
        raise DatasetError("missing", file=store.full_path(_PLAN[1]), remedy="restore the object")
    rigs = [f"rigs/{name}" for name in store.list_files("rigs") if name.endswith(".json")]
    for name, data in {**found, **store.read_many(rigs)}.items():
        write_bytes(scratch.root / name, data)


def commit_plan(destination: BucketDestination, settings: IngestSettings, scratch: Layout) -> None:
    """Commit the document and the scenes of a run; the same ones are done.

    Raises:
        UsageError: the server ignores the condition of conditional puts.
        DatasetError: the dataset has other scenes or another document, or the bucket cannot be written.
    """
    there = {name: (scratch.root / name).read_bytes() for name in _PLAN if (scratch.root / name).exists()}
    write_json(scratch.document, settings.document)
    write_rois(scratch.rois, settings.rois)
    for name in reversed(_PLAN):
        data = (scratch.root / name).read_bytes()
        if there.get(name, data) != data:
            raise DatasetError(
                "the dataset in the bucket has another one, which is never written again",
                file=destination.store.full_path(name), expected="the scenes and the licence that it was made with",
                remedy=_CREATED,
            )  # fmt: skip
        destination.commit_bytes(name, data)
    destination.require_conditional_puts(_PLAN[0], (scratch.root / _PLAN[0]).read_bytes())


def append_committed(destination: BucketDestination, scratch: Layout, drives: Sequence[str]) -> None:
    """Add drives that jobs committed to the index, which is derived from their tables.

    Args:
        destination: the dataset.
        scratch: a folder of this machine, into which the tables are copied.
        drives: the drives.

    Raises:
        DatasetError: the bucket cannot be read or written.
    """
    copy_drives(destination.store, scratch, drives)
    append_drives(scratch, drives, destination=destination)


def refuse_options_of_folders(options: IngestOptions, out: str) -> None:
    """Refuse what replaces files, which a bucket never does.

    Raises:
        UsageError: an option does.
    """
    given = {
        "--replace": options.replace,
        "--map": bool(options.maps),
        "--verify": options.verify,
        "--retry-failed": options.retry_failed,
    }
    for name, is_given in given.items():
        if is_given:
            raise UsageError(
                "only a dataset in a folder is changed", file=out, place=name, expected="recordings that are new",
                remedy=f"leave {name} out, or ingest into a folder and copy that to a new place in the bucket",
            )  # fmt: skip


def _remove_images(recorded: Path) -> None:
    manifest = complete_manifest(recorded)
    if manifest is None:
        return
    for path in sorted(recorded.rglob("*"), reverse=True):
        if path.is_dir():
            path.rmdir()
        elif path.relative_to(recorded).as_posix() not in {*manifest.files, "manifest.json"}:
            path.unlink()
