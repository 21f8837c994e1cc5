"""The paths in a dataset's folder, and the manifests that mark folders as complete."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mirror.errors import DatasetError, SchemaError
from mirror.schema.documents import FileEntry, ImageTotals, Manifest
from mirror.schema.files import read_json, write_json
from mirror.schema.snapshot import SNAPSHOTS

MANIFEST = "manifest.json"
_URL: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/+")
MAPS = "maps"
"""Folder of the recorded road maps, one folder a scene."""


@dataclass(frozen=True)
class Layout:
    """Paths of a dataset below ``root``. Only `drive_ids` and `layers` read the disk."""

    root: Path

    @property
    def document(self) -> Path:
        """``dataset.json``."""
        return self.root / "dataset.json"

    @property
    def rois(self) -> Path:
        """``rois.geojson``."""
        return self.root / "rois.geojson"

    @property
    def lock(self) -> Path:
        """The lock file of writers."""
        return self.root / ".lock"

    @property
    def index(self) -> Path:
        """The folder of the index: the derived tables."""
        return self.root / "index"

    @property
    def snapshots(self) -> Path:
        """The folder of the index's snapshots."""
        return self.root / SNAPSHOTS

    def segment(self, name: str) -> Path:
        """Return the folder of a segment of the index."""
        return self.index / name

    def rig(self, rig_id: str) -> Path:
        """Return ``rigs/<rig_id>.json``."""
        return self.root / "rigs" / f"{rig_id}.json"

    def drive(self, drive_id: str) -> Path:
        """Return the folder of one drive."""
        return self.root / "drives" / drive_id

    def traversal(self, traversal_id: str) -> Path:
        """Return the folder of one traversal."""
        return self.root / "traversals" / traversal_id

    def recorded(self, traversal_id: str) -> Path:
        """Return the folder of a traversal's recorded files, which never change."""
        return self.traversal(traversal_id) / "recorded"

    def layer(self, traversal_id: str, kind: str, source: str, version: str) -> Path:
        """Return the folder of one layer.

        Args:
            traversal_id: the traversal.
            kind: poses, calibrations, boxes, masks, redaction, depth, points or lidars.
            source: who made it.
            version: version of the source.
        """
        return self.traversal(traversal_id) / "layers" / kind / f"{source}@{version}"

    def split(self, name: str) -> Path:
        """Return ``splits/<name>.json``."""
        return self.root / "splits" / f"{name}.json"

    def drive_ids(self) -> list[str]:
        """Return the ids of the complete drives, sorted."""
        return sorted(folder.name for folder in _complete(self.root / "drives"))

    def road_map(self, scene_id: str) -> Path:
        """Return the folder of the recorded road map of a scene."""
        return self.root / MAPS / scene_id

    def layers(self, traversal_id: str) -> list[tuple[str, str, str]]:
        """Return the complete layers of a traversal as ``(kind, source, version)``, sorted."""
        found = []
        for kind in _folders(self.traversal(traversal_id) / "layers"):
            for folder in _complete(kind):
                source, _, version = folder.name.partition("@")
                found.append((kind.name, source, version))
        return sorted(found)


def _folders(parent: Path) -> Iterator[Path]:
    if parent.is_dir():
        yield from (folder for folder in parent.iterdir() if folder.is_dir() and not folder.name.startswith("."))


def _complete(parent: Path) -> Iterator[Path]:
    yield from (folder for folder in _folders(parent) if (folder / MANIFEST).is_file())


def not_a_dataset_error(root: str | Path, *, exists: bool) -> DatasetError:
    """Make the error for a path that is not a dataset."""
    if not exists and (url := _URL.match(str(root))) is not None:
        # `Path` reads s3://bucket as a folder s3:.
        place = f"{url[1]}://{str(root)[url.end() :]}"
        return DatasetError(
            "this changes a dataset in a folder, and takes no URL", file=place, expected="a folder of this machine",
            remedy=f"bring a part to this machine: mirror dataset fetch {place} --scene ID --out FOLDER",
        )  # fmt: skip
    return DatasetError(
        "not a dataset: dataset.json is missing" if exists else "the folder does not exist",
        file=root,
        expected="the folder that `mirror ingest --out` wrote",
        remedy="check the path, or make a dataset: mirror ingest RECORDING... --rois FILE --out DATASET",
    )


def require_dataset(layout: Layout) -> None:
    """Raise an error if a folder is not a dataset.

    Raises:
        DatasetError: ``dataset.json`` is missing.
    """
    if not layout.document.is_file():
        raise not_a_dataset_error(layout.root, exists=layout.root.exists())


def seal(
    folder: Path,
    files: Mapping[str, bytes],
    *,
    derived_from: Mapping[str, str],
    images: ImageTotals | None = None,
) -> None:
    """Complete a folder by writing its manifest, which must be its last file.

    Args:
        folder: a folder with all its files.
        files: bytes of every file except the images, by path relative to the folder.
        derived_from: hashes of the inputs of the folder, by name.
        images: number and total size of the images; None: the folder has none.
    """
    entries = {
        name: FileEntry(bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
        for name, data in sorted(files.items())
    }
    manifest = Manifest(derived_from=dict(sorted(derived_from.items())), files=entries, pictures=images)
    write_json(folder / MANIFEST, manifest)


def read_manifest(folder: Path) -> Manifest | None:
    """Read the manifest of a folder; None if there is none: the folder counts as missing.

    Raises:
        SchemaError: the manifest is broken.
    """
    path = folder / MANIFEST
    return read_json(path, Manifest) if path.is_file() else None


def complete_manifest(folder: Path) -> Manifest | None:
    """Read the manifest of a folder; None if missing or broken: a writer has to write the folder again."""
    try:
        return read_manifest(folder)
    except SchemaError:
        return None


def is_intact(folder: Path) -> bool:
    """Return whether a folder is complete and its files, except images, have the hashes in its manifest."""
    manifest = complete_manifest(folder)
    if manifest is None:
        return False
    for name, entry in manifest.files.items():
        path = folder / name
        if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != entry.sha256:
            return False
    return True


def manifest_sha256(folder: Path) -> str:
    """Return the SHA-256 of the manifest's bytes, which identifies the contents of a complete folder."""
    return hashlib.sha256((folder / MANIFEST).read_bytes()).hexdigest()
