"""A release for its rules: its documents, log and images, read once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from mirror.dataset.index.snapshots import list_snapshots, read_snapshot
from mirror.dataset.layout import Layout, read_manifest
from mirror.dataset.store import Store
from mirror.errors import DatasetError
from mirror.privacy.log import ImageRecord, read_log
from mirror.privacy.release.document import DATASHEET, DOCUMENT, LICENCE, LOG, Release
from mirror.privacy.release.tree import LAYER_TABLES, read_drives
from mirror.schema.documents import DriveDocument, Manifest, Rig
from mirror.schema.files import read_json, read_table
from mirror.schema.links import refuse_links_out
from mirror.schema.snapshot import SOURCES, snapshot_path
from mirror.schema.tables import IMAGES, MASKS, Table

ImageName = tuple[str, str, int]
"""Traversal, camera, timestamp_ns."""


class ReleaseView:
    """A release in the form in which the rules read it: documents, tables and files.

    Args:
        root: folder of the release.
        models: folders of models that are to be released with it.

    Raises:
        DatasetError: the folder holds no release, its log is missing, or a link leads out of it.
        SchemaError: a document is broken.
    """

    def __init__(self, root: Path, models: Sequence[Path] = ()) -> None:
        refuse_links_out(root)
        self.root = root
        self.layout = Layout(root)
        self.models = models
        if not (root / DOCUMENT).is_file():
            raise DatasetError(
                f"no {DOCUMENT} here", file=root, expected="the folder of a release",
                remedy="build one: mirror release build DATASET --out RELEASE",
            )  # fmt: skip
        self.release = read_json(root / DOCUMENT, Release)
        if not (root / LOG).is_file():
            raise DatasetError("missing", file=root / LOG, expected="the log of the redaction", remedy="build it again")
        self.records: Sequence[ImageRecord] = read_log(root / LOG)

    @cached_property
    def log(self) -> Mapping[ImageName, ImageRecord]:
        """Lines of the log by image."""
        return {record.key: record for record in self.records}

    @cached_property
    def drives(self) -> Sequence[tuple[DriveDocument, Sequence[str]]]:
        """Drives with the ids of their traversals."""
        return list(read_drives(self.layout))

    @cached_property
    def traversals(self) -> Sequence[str]:
        """Ids of the traversals."""
        return [name for _, names in self.drives for name in names]

    @cached_property
    def images(self) -> Mapping[ImageName, Mapping[str, Any]]:
        """Rows of the images tables, by image."""
        return {
            (name, row["camera"], row["timestamp_ns"]): row
            for name in self.traversals
            for row in read_table(self.layout.recorded(name) / "images.parquet", IMAGES).to_pylist()
        }

    def layers(self) -> Iterator[tuple[str, str, Manifest]]:
        """Yield the traversal, ``kind/source@version`` and manifest of each layer."""
        for name in self.traversals:
            for kind, source, version in self.layout.layers(name):
                manifest = read_manifest(self.layout.layer(name, kind, source, version))
                if manifest is not None:
                    yield name, f"{kind}/{source}@{version}", manifest

    def content(self, traversal_id: str) -> str | None:
        """Return the hash of the contents of a traversal's recorded folder."""
        manifest = read_manifest(self.layout.recorded(traversal_id))
        return None if manifest is None else manifest.content

    @cached_property
    def named_files(self) -> frozenset[str]:
        """Every file that a document, manifest or table of the release names, relative to the root."""
        names = {"dataset.json", "rois.geojson", DOCUMENT, DATASHEET, LICENCE, LOG}
        folders = [self.layout.recorded(name) for name in self.traversals]
        folders += [self.layout.drive(drive.drive_id) for drive, _ in self.drives]
        for name in self.traversals:
            for layer in self.layout.layers(name):
                folder = self.layout.layer(name, *layer)
                folders.append(folder)
                table = LAYER_TABLES.get(layer[0])
                if table is not None and "uri" in table.schema.names:
                    names.update(self._uris(folder, table))
        for number in list_snapshots(Store(self.root)):
            names.add(snapshot_path(number))
            for segment in read_snapshot(Store(self.root), number).segments:
                names.add(f"index/{segment.name}/{SOURCES}")
                folders.append(self.layout.segment(segment.name))
        for folder in folders:
            manifest = read_manifest(folder)
            place = folder.relative_to(self.root).as_posix()
            if manifest is not None:
                names |= {f"{place}/manifest.json", *(f"{place}/{name}" for name in manifest.files)}
        names |= {f"rigs/{rig.rig_id}.json" for rig in self._rigs} | self.masks
        names |= {row["uri"] for row in self.images.values()}
        names |= {f"splits/{path.name}" for path in (self.root / "splits").glob("*.json")}
        return frozenset(names)

    @cached_property
    def masks(self) -> frozenset[str]:
        """The masks of the rigs and of all layers, relative to the root."""
        names = {f"rigs/{one.static_mask}" for rig in self._rigs for one in rig.cameras if one.static_mask}
        for name in self.traversals:
            for layer in self.layout.layers(name):
                if layer[0] == MASKS.name:
                    names.update(self._uris(self.layout.layer(name, *layer), MASKS))
        return frozenset(names)

    @cached_property
    def _rigs(self) -> Sequence[Rig]:
        rig_ids = {drive.rig_id for drive, _ in self.drives if drive.rig_id is not None}
        return [read_json(self.layout.rig(rig_id), Rig) for rig_id in sorted(rig_ids)]

    def _uris(self, folder: Path, table: Table) -> list[str]:
        uris: list[str] = read_table(folder / f"{table.name}.parquet", table, ["uri"]).column("uri").to_pylist()
        return uris

    @cached_property
    def files(self) -> Sequence[str]:
        """Every file below the root, sorted."""
        return sorted(path.relative_to(self.root).as_posix() for path in self.root.rglob("*") if not path.is_dir())
