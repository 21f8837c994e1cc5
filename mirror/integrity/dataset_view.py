"""A dataset for the rules: everything that can be read, and the errors of unreadable files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pyarrow as pa

from mirror.dataset.index.build import find_changes
from mirror.dataset.index.inputs import IndexInputs, read_inputs, read_rois
from mirror.dataset.index.snapshots import IndexState, list_snapshots, read_state
from mirror.dataset.index.table_copy import TableCopy
from mirror.dataset.layout import MANIFEST, MAPS, Layout
from mirror.dataset.query.catalog import Catalog
from mirror.dataset.recorded_map import MAP_FILE
from mirror.dataset.splits.candidates import Candidate, Candidates
from mirror.dataset.splits.leaks import Tie, find_ties
from mirror.dataset.store import Store
from mirror.dataset.taken_down import CameraStamp, group_by_traversal, read_take_downs
from mirror.errors import DatasetError, MirrorError, SchemaError, UsageError
from mirror.geometry.cameras import Camera
from mirror.integrity.rows import TablePart, TableRows
from mirror.pools import thread_pool, usable_cores
from mirror.schema.bundle import BUNDLE, Bundle
from mirror.schema.documents import DatasetDocument, DriveDocument, FileEntry, Manifest, Rig, Roi, SplitDocument
from mirror.schema.files import Model, read_json, read_table
from mirror.schema.index_tables import ROW_GROUPS
from mirror.schema.references import REFERENCES, ImageReferences
from mirror.schema.road_map import RoadMap, read_road_map, require_map_of
from mirror.schema.snapshot import snapshot_path
from mirror.schema.tables import PASSES, Table
from mirror.schema.take_downs import TAKE_DOWNS

TRAVERSAL_KEY = "traversal:"


@dataclass(frozen=True)
class TraversalView:
    """A traversal that a drive names and that is complete.

    Attributes:
        traversal_id: the traversal.
        scene: its scene.
        drive: its drive.
        rig: the drive's rig; None if it has none, or if it cannot be read.
        layers: complete layers as (kind, source, version).
        ledger_row: its accepted row of the ledger; None if there is none.
    """

    traversal_id: str
    scene: Roi
    drive: DriveDocument
    rig: Rig | None
    layers: Sequence[tuple[str, str, str]]
    ledger_row: Mapping[str, object] | None


class DatasetView:
    """Documents, manifests and ledgers of a dataset; broken ones are left out, and their errors are kept.

    Args:
        layout: the dataset; or a copy of its documents and tables, see `local_tables`.
        images: where its other files lie, if not there.
        sizes: sizes of those files, by path; None: they are asked for.

    Attributes:
        problems: why a file could not be read, by the file relative to the root.
        cameras: the cameras that were made so far, so that equal ones are made once.
    """

    def __init__(self, layout: Layout, images: Store | None = None, sizes: Mapping[str, int] | None = None) -> None:
        self.layout = layout
        self.store = Store(layout.root)
        self.image_store = self.store if images is None else images
        self.sizes = sizes
        self.problems: dict[str, MirrorError] = {}
        self.cameras: dict[Camera, Camera] = {}

    def name(self, path: Path) -> str:
        """Return a path relative to the dataset's root."""
        return path.relative_to(self.layout.root).as_posix()

    @cached_property
    def document(self) -> DatasetDocument | None:
        """``dataset.json``."""
        return self._read(self.layout.document, DatasetDocument)

    @cached_property
    def scenes(self) -> Mapping[str, Roi]:
        """Regions of interest by scene id."""
        try:
            return read_rois(self.store)
        except MirrorError as error:
            self.problems[self.name(self.layout.rois)] = error
            return {}

    @cached_property
    def drive_manifests(self) -> Mapping[str, Manifest]:
        """Manifests of the complete drives, by the name of their folder."""
        return {
            folder.name: manifest
            for folder, manifest in self.folder_manifests.items()
            if folder.parent.name == "drives"
        }

    @cached_property
    def drives(self) -> Mapping[str, DriveDocument]:
        """Documents of the complete drives, by the name of their folder."""
        found = {
            name: self._read(self.layout.drive(name) / "drive.json", DriveDocument) for name in self.drive_manifests
        }
        return {name: drive for name, drive in found.items() if drive is not None}

    @cached_property
    def rigs(self) -> Mapping[str, Rig]:
        """The rigs that drives name, by id."""
        names = sorted({drive.rig_id for drive in self.drives.values() if drive.rig_id is not None})
        found = {name: self._read(self.layout.rig(name), Rig) for name in names}
        return {name: rig for name, rig in found.items() if rig is not None}

    @cached_property
    def folder_manifests(self) -> Mapping[Path, Manifest]:
        """Manifests of all complete folders but those of the index."""
        found = {folder: self._manifest(folder) for folder in self.folders_with_manifest()}
        return {folder: manifest for folder, manifest in found.items() if manifest is not None}

    @cached_property
    def recorded_manifests(self) -> Mapping[str, Manifest]:
        """Manifests of the complete recorded folders, by the name of the traversal's folder."""
        return {
            folder.parent.name: manifest
            for folder, manifest in self.folder_manifests.items()
            if folder.name == "recorded" and folder.parent.parent.name == "traversals"
        }

    @cached_property
    def road_maps(self) -> Mapping[str, RoadMap]:
        """Recorded road maps by the name of their folder; each is of a scene of the dataset, and in its frame."""
        found = {}
        for folder in self.folder_manifests:
            path = folder / MAP_FILE
            if folder.parent.name != MAPS or not path.is_file():
                continue
            try:
                road_map, roi = read_road_map(path), self.scenes.get(folder.name)
                if roi is None:
                    raise UsageError("the map of a scene that the dataset does not have", file=path)
                require_map_of(road_map, roi, path)
                found[folder.name] = road_map
            except MirrorError as error:
                self.problems[self.name(path)] = error
        return found

    @cached_property
    def bundle(self) -> Bundle | None:
        """The document of a published dataset; None for other datasets, and if the document is broken."""
        file = self.layout.root / BUNDLE
        return self._read(file, Bundle) if file.is_file() else None

    @cached_property
    def taken_down(self) -> Mapping[str, frozenset[CameraStamp]]:
        """Images that were taken down, by traversal; none where their list is broken, which is kept as a problem."""
        try:
            return group_by_traversal(read_take_downs(self.store))
        except SchemaError as error:
            self.problems[TAKE_DOWNS] = error
            return {}

    @cached_property
    def withheld(self) -> frozenset[str]:
        """Paths of the images that a published dataset leaves out; empty for other datasets."""
        return frozenset() if self.bundle is None else frozenset(self.bundle.withheld)

    @cached_property
    def index_state(self) -> IndexState | None:
        """The newest snapshot of the index with its sources; None if it is missing, or broken: a problem is kept."""
        numbers = list_snapshots(self.store)
        try:
            return read_state(self.store)
        except MirrorError as error:
            self.problems[snapshot_path(numbers[-1])] = error
            return None

    @cached_property
    def index_manifests(self) -> Mapping[Path, Manifest]:
        """Manifests of the segments of the newest snapshot."""
        segments = () if self.index_state is None else self.index_state.snapshot.segments
        found = {folder: self._manifest(folder) for folder in (self.layout.segment(one.name) for one in segments)}
        return {folder: manifest for folder, manifest in found.items() if manifest is not None}

    @cached_property
    def index_inputs(self) -> IndexInputs | None:
        """The inputs of an index; None if a file is missing or broken, which other rules report."""
        try:
            return read_inputs(self.store)
        except MirrorError:
            return None

    @cached_property
    def index_row_groups(self) -> pa.Table | None:
        """The index's list of row groups; None where the index is missing, broken or stale."""
        inputs, state = self.index_inputs, self.index_state
        if inputs is None or state is None or find_changes(state.sources, inputs):
            return None
        try:
            catalog = Catalog(self.store, state.snapshot)
            return catalog.read_global(ROW_GROUPS.name, ROW_GROUPS.schema.names)
        except MirrorError as error:
            self.problems[self.name(Path(error.file or self.layout.index))] = error
            return None

    @cached_property
    def named_traversals(self) -> Mapping[str, tuple[str, str]]:
        """Traversals that drives name: their drive's folder and the manifest's hash, by id."""
        return {
            key.removeprefix(TRAVERSAL_KEY): (drive, value)
            for drive, manifest in self.drive_manifests.items()
            for key, value in manifest.derived_from.items()
            if key.startswith(TRAVERSAL_KEY)
        }

    @cached_property
    def passes(self) -> TableRows:
        """The ledgers of all drives."""
        folders = [(number, self.layout.drive(name)) for number, name in enumerate(self.drive_manifests)]
        return TableRows(PASSES, self.parts(PASSES, folders))

    @cached_property
    def traversals(self) -> Mapping[str, TraversalView]:
        """Traversals that are named, complete, and of a scene and a drive that can be read; by id."""
        accepted = {row["traversal_id"]: row for row in self.passes.data.to_pylist() if row["traversal_id"] is not None}
        found = {}
        for traversal_id, (drive_name, _) in sorted(self.named_traversals.items()):
            scene, drive = self.scenes.get(traversal_id.partition(".")[0]), self.drives.get(drive_name)
            if scene is not None and drive is not None and traversal_id in self.recorded_manifests:
                found[traversal_id] = TraversalView(
                    traversal_id,
                    scene,
                    drive,
                    None if drive.rig_id is None else self.rigs.get(drive.rig_id),
                    self.layout.layers(traversal_id),
                    accepted.get(traversal_id),
                )
        return found

    @cached_property
    def splits(self) -> Mapping[str, SplitDocument]:
        """Splits by name."""
        found = {path.stem: self._read(path, SplitDocument) for path in sorted(self.layout.root.glob("splits/*.json"))}
        return {name: split for name, split in found.items() if split is not None}

    @cached_property
    def candidates(self) -> Candidates:
        """The traversals as candidates of splits."""
        found = {
            key: Candidate(
                traversal_id=key,
                scene_id=item.scene.scene_id,
                drive_id=item.drive.drive_id,
                vehicle_id=item.drive.vehicle_id,
                entry_ns=int(str(item.ledger_row["entry_ns"])),
                exit_ns=int(str(item.ledger_row["exit_ns"])),
                light=str(item.ledger_row["light"]),
                weather=str(item.ledger_row["weather"]),
                content=self.recorded_manifests[key].content,
            )
            for key, item in self.traversals.items()
            if item.ledger_row is not None
        }
        return Candidates(self.layout, self.scenes, found, self.table)

    @cached_property
    def ties(self) -> Sequence[Tie]:
        """Ties between traversals, including ties of scenes."""
        return find_ties(self.candidates, by_scene=True)

    @classmethod
    def of_copy(cls, copy: TableCopy) -> DatasetView:
        """Return the view of a dataset by a copy of its documents and tables."""
        if copy.store.folder is not None:
            return cls(copy.layout)
        return cls(copy.layout, copy.store, {name: file.bytes for name, file in copy.files.items()})

    def etags(self, traversal_id: str) -> Mapping[str, str]:
        """Return the ETags of a traversal's images outside of the dataset, by uri; a broken list counts as none."""
        path = self.layout.recorded(traversal_id) / REFERENCES
        found = self._read(path, ImageReferences) if path.is_file() else None
        return {} if found is None else found.etags

    def folders(self, name: str) -> list[Path]:
        """Return the subfolders of a folder of the dataset, sorted, without hidden ones."""
        parent = self.layout.root / name
        found = parent.iterdir() if parent.is_dir() else ()
        return sorted(folder for folder in found if folder.is_dir() and not folder.name.startswith("."))

    def layer_folders(self, traversal: str) -> list[Path]:
        """Return the folders of a traversal's layers, complete or not."""
        kinds = self.folders(f"traversals/{traversal}/layers")
        return [layer for kind in kinds for layer in self.folders(self.name(kind))]

    def folders_with_manifest(self) -> Iterator[Path]:
        """Yield the folders that are complete once they have a manifest, except the index."""
        yield from self.folders("drives")
        yield from self.folders(MAPS)
        for folder in self.folders("traversals"):
            yield folder / "recorded"
            yield from self.layer_folders(folder.name)

    def listed_files(self) -> Iterator[tuple[Path, FileEntry]]:
        """Yield the files that manifests list, including the files of the index."""
        for folder, manifest in {**self.folder_manifests, **self.index_manifests}.items():
            for name, entry in manifest.files.items():
                yield folder / name, entry

    def parts(self, table: Table, folders: Sequence[tuple[int, Path]]) -> list[TablePart]:
        """Return one table from many folders; folders without it, or with a broken one, are left out.

        Args:
            table: which.
            folders: the folders, each with the number by which its rows are to be known.
        """
        paths = [folder / f"{table.name}.parquet" for _, folder in folders]
        with thread_pool(usable_cores()) as pool:
            tables = pool.map(lambda path: self.table(path, table), paths)
        read = zip(paths, folders, tables)
        return [(self.name(path), number, data) for path, (number, _), data in read if data is not None]

    def table(self, path: Path, table: Table, columns: Sequence[str] | None = None) -> pa.Table | None:
        """Return a table, or columns of it; None if its file is missing, or broken, which is kept as a problem."""
        try:
            return read_table(path, table, columns)
        except SchemaError as error:
            self.problems[self.name(path)] = error
        except DatasetError:
            # The rules of manifests report missing files.
            pass
        return None

    def _manifest(self, folder: Path) -> Manifest | None:
        return self._read(folder / MANIFEST, Manifest) if (folder / MANIFEST).is_file() else None

    def _read(self, path: Path, model: type[Model]) -> Model | None:
        try:
            return read_json(path, model)
        except (SchemaError, DatasetError) as error:
            self.problems[self.name(path)] = error
            return None
