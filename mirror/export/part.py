"""Fetching of a part of a dataset: some scenes, cameras and conditions become a dataset of their own."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from mirror.dataset.dataset import Dataset
from mirror.dataset.dataset import open as open_dataset
from mirror.dataset.images.shards import is_shard, pack_images
from mirror.dataset.index.build import build_index
from mirror.dataset.index.inputs import read_rois
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout, complete_manifest, manifest_sha256, seal
from mirror.dataset.lock import writer_lock
from mirror.dataset.read_ahead import ByteRange, ReadAhead
from mirror.dataset.redaction import REDACTION
from mirror.errors import DatasetError, UsageError
from mirror.ingest.rois import write_rois
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.documents import DriveDocument, ImageTotals, Manifest, Rig
from mirror.schema.files import encode_table, read_table, write_bytes, write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.hashing import hash_document
from mirror.schema.tables import CALIBRATIONS, EGO_POSES, IMAGES, LAYER_TABLES, PASSES, Table

_MARK: Final = ".part-of"
_AT_ONCE: Final = 64
_SUFFIX: Final = {"jpeg": "jpg", "png": "png"}


@dataclass(frozen=True)
class FetchedPart:
    """The result of fetching a part.

    Attributes:
        traversals: number of traversals of the part.
        kept: those of them that an earlier call had fetched.
        images: number of images of the part.
        bytes: of the images that this call fetched.
    """

    traversals: int
    kept: int
    images: int
    bytes: int


def fetch_part(
    url: str,
    out: Path,
    *,
    scenes: Sequence[str] = (),
    cameras: Sequence[str] = (),
    lights: Sequence[str] = (),
    progress: ProgressReporter | None = None,
) -> FetchedPart:
    """Bring a part of a dataset to this machine, as a dataset of its own. Repeated, an interrupted call continues.

    Images that a redaction replaced come redacted, as images of the recording; those that a published dataset withholds
    are left out. Layers of the part come with it, except redactions. Splits stay behind: they name the whole.

    Args:
        url: folder or URL of the dataset.
        out: a new folder, or that of an interrupted call.
        scenes: ids; none: all.
        cameras: names; none: all.
        lights: ``day``, ``dusk`` or ``night``; none: all.
        progress: receives the number of images.

    Raises:
        UsageError: the dataset does not know a value, or the folder has something else.
        DatasetError: there is no dataset, a file is missing or has other bytes, or the folder cannot be written.
    """
    reporter = progress or NullProgress()
    whole = open_dataset(url)
    view = whole.where(scene=scenes or None, camera=cameras or None, light=lights or None)
    names = view.traversals()
    if not names:
        raise UsageError(
            "no traversal is in this part", file=url, expected="scenes, cameras and conditions that occur together",
            remedy="`mirror stats` counts them",
        )  # fmt: skip
    layout = Layout(out)
    kind = require_output_folder(out, FolderKind.DATASET)
    mark = hash_document([str(url), whole.index_sha256, sorted(scenes), sorted(cameras), sorted(lights)]).encode()
    if kind is not None and (not (out / _MARK).is_file() or (out / _MARK).read_bytes() != mark):
        raise UsageError(
            "another dataset: nothing was written", file=out, place="--out",
            expected="a new folder, or that of an interrupted call of the same part", remedy="name another --out",
        )  # fmt: skip
    with writer_lock(layout, wait=False):
        write_bytes(out / _MARK, mark)
        write_json(layout.document, whole.document)
        rois = read_rois(whole.store)
        write_rois(layout.rois, [rois[scene_id] for scene_id in view.scenes()])
        part = _Part(view, layout, frozenset(cameras) or None, mark.decode(), reporter)
        reporter.start("fetching (images)", view.count("images"))
        for name in names:
            part.fetch_traversal(name)
        for drive_id in view.drives():
            part.fetch_drive(drive_id, frozenset(names))
        build_index(out, compact=True)
    return FetchedPart(len(names), part.kept, open_dataset(out).count("images"), part.bytes)


class _Part:
    """A part that is being fetched."""

    def __init__(
        self, view: Dataset, layout: Layout, cameras: frozenset[str] | None, mark: str, progress: ProgressReporter
    ) -> None:
        self._view = view
        self._store = view.store
        self._layout = layout
        self._cameras = cameras
        self._mark = {"part": mark}
        self._progress = progress
        self._ahead = ReadAhead(view.store)
        self.kept = 0
        self.bytes = 0

    def fetch_traversal(self, traversal_id: str) -> None:
        """Fetch the recorded tables, images and layers of a traversal, unless they are there."""
        folder = self._layout.recorded(traversal_id)
        view = self._view.where(traversal=traversal_id)
        manifest = complete_manifest(folder)
        if manifest is not None and manifest.derived_from == self._mark:
            self.kept += 1
            self._progress.advance(view.count("images"))
        else:
            shutil.rmtree(self._layout.traversal(traversal_id), ignore_errors=True)
            poses = view.table("ego_poses", EGO_POSES.schema.names)
            calibrations = self._of_cameras(view.table("calibrations", CALIBRATIONS.schema.names))
            images = self._fetch_images(traversal_id, view.where(withheld=False).table("images", IMAGES.schema.names))
            files = {}
            for table, rows in ((EGO_POSES, poses), (CALIBRATIONS, calibrations), (IMAGES, images)):
                files[f"{table.name}.parquet"] = encode_table(rows, table)
                write_bytes(folder / f"{table.name}.parquet", files[f"{table.name}.parquet"])
            places = set(zip(*(images.column(name).to_pylist() for name in ("uri", "byte_offset", "byte_length"))))
            totals = ImageTotals(count=images.num_rows, bytes=sum(length for _, _, length in places))
            seal(folder, files, derived_from=self._mark, images=totals)
        (names,) = view.table("traversals", ["layers"]).column(0).to_pylist()
        for name in names:
            kind, _, rest = name.partition("/")
            source, _, version = rest.partition("@")
            there = complete_manifest(self._layout.layer(traversal_id, kind, source, version))
            # Files of the source, such as sweeps of lidars, lie elsewhere: their references stay behind.
            if kind != REDACTION and kind in LAYER_TABLES and there is None:
                self._fetch_layer(traversal_id, kind, source, version)

    def fetch_drive(self, drive_id: str, traversals: frozenset[str]) -> None:
        """Fetch the document, the ledger and the rig of a drive, with the passes of the part."""
        place, folder = f"drives/{drive_id}", self._layout.drive(drive_id)
        document = self._store.json(f"{place}/drive.json", DriveDocument)
        scenes = frozenset(self._view.scenes())
        document = document.model_copy(update={"scenes": tuple(one for one in document.scenes if one in scenes)})
        if document.rig_id is not None:
            self._fetch_rig(document.rig_id)
        ledger = self._read_table(f"{place}/passes.parquet", PASSES)
        rows = [
            row
            for row in ledger.to_pylist()
            if row["scene_id"] in scenes and (row["traversal_id"] is None or row["traversal_id"] in traversals)
        ]
        data = encode_table(pa.Table.from_pylist(rows, schema=PASSES.schema), PASSES)
        write_json(folder / "drive.json", document)
        write_bytes(folder / "passes.parquet", data)
        derived = dict(self._store.json(f"{place}/manifest.json", Manifest).derived_from)
        kept = {key: value for key, value in derived.items() if not key.startswith("traversal:")}
        for row in rows:
            if row["traversal_id"] is not None:
                kept[f"traversal:{row['traversal_id']}"] = manifest_sha256(self._layout.recorded(row["traversal_id"]))
        files = {"drive.json": (folder / "drive.json").read_bytes(), "passes.parquet": data}
        seal(folder, files, derived_from=kept)

    def _fetch_rig(self, rig_id: str) -> None:
        rig = self._store.json(f"rigs/{rig_id}.json", Rig)
        cameras = tuple(one for one in rig.cameras if self._cameras is None or one.name in self._cameras)
        names = [one.name for one in cameras]
        reference = rig.reference_camera if rig.reference_camera in names else names[0]
        for one in cameras:
            if one.static_mask is not None:
                write_bytes(self._layout.root / "rigs" / one.static_mask, self._store.read(f"rigs/{one.static_mask}"))
        rig = rig.model_copy(update={"cameras": cameras, "reference_camera": reference})
        write_json(self._layout.rig(rig_id), rig)

    def _fetch_images(self, traversal_id: str, images: pa.Table) -> pa.Table:
        """Fetch the images of a traversal; returns their rows with their places on this machine."""
        folder = f"traversals/{traversal_id}/recorded"
        rows, sources = images.to_pylist(), images.column("uri").to_pylist()
        groups = [range(start, min(start + _AT_ONCE, len(rows))) for start in range(0, len(rows), _AT_ONCE)]
        for numbers in self._ahead.over(groups, lambda some: _ranges(rows, some, self._ahead)):
            for number in numbers:
                self._fetch_image(rows[number], folder)
            self._progress.advance(len(numbers))
        fetched = pa.Table.from_pylist(rows, schema=IMAGES.schema)
        if any(is_shard(uri) for uri in sources):
            fetched = pack_images(fetched, self._layout.root, folder)
        return fetched

    def _fetch_image(self, row: dict[str, Any], folder: str) -> None:
        uri, offset, length = row["uri"], row["byte_offset"], row["byte_length"]
        is_video = row["codec"] == "video"
        name = (
            PurePosixPath(uri).name if is_video else f"{row['timestamp_ns']}.{_SUFFIX.get(row['codec'], row['codec'])}"
        )
        row["uri"], row["byte_offset"] = f"{folder}/{row['camera']}/{name}", 0
        path = self._layout.root / row["uri"]
        if is_video and path.exists():
            return
        try:
            held = self._ahead.take(uri, offset, length)
            data = self._store.read_range(uri, offset, length) if held is None else held
        except OSError as error:
            raise DatasetError(
                f"cannot be read: {error.strerror or error}", file=self._store.full_path(uri), expected="an image",
                remedy="run the same command again: it resumes where it stopped",
            ) from error  # fmt: skip
        sha256 = hashlib.sha256(data).digest()
        if len(data) != length or row["sha256"] not in (None, sha256):
            raise DatasetError(
                "the bytes differ from the hash or the size in the table", file=self._store.full_path(uri),
                place=f"byte {offset}", expected=f"{length} bytes", remedy="restore the file where the dataset lies",
            )  # fmt: skip
        row["sha256"] = sha256
        write_bytes(path, data)
        self.bytes += length

    def _fetch_layer(self, traversal_id: str, kind: str, source: str, version: str) -> None:
        table = LAYER_TABLES[kind]
        place = f"traversals/{traversal_id}/layers/{kind}/{source}@{version}"
        rows = self._of_cameras(self._read_table(f"{place}/{table.name}.parquet", table))
        writer = LayerWriter(self._layout, traversal_id, kind, source, version, self._mark)
        if "uri" in table.schema.names:
            plain = rows.to_pylist()
            for row in plain:
                row |= writer.file(
                    PurePosixPath(row["uri"]).relative_to(place).as_posix(), self._store.read(row["uri"])
                )
            rows = pa.Table.from_pylist(plain, schema=table.schema)
        own = [name for name in rows.column_names if name not in ("source", "source_version")]
        writer.finish(table, rows.select(own))

    def _read_table(self, path: str, table: Table) -> pa.Table:
        try:
            data = self._store.read(path)
        except FileNotFoundError as error:
            raise DatasetError(
                "missing", file=self._store.full_path(path), expected=f"the table {table.name}"
            ) from error
        return read_table(Path(self._store.full_path(path)), table, data=data)

    def _of_cameras(self, rows: pa.Table) -> pa.Table:
        if self._cameras is None or "camera" not in rows.column_names:
            return rows
        return rows.filter(pc.is_in(rows.column("camera").cast(pa.string()), pa.array(sorted(self._cameras))))


def _ranges(rows: Sequence[Mapping[str, Any]], numbers: Sequence[int], ahead: ReadAhead) -> list[ByteRange]:
    """Return the places of images that are far away; a video is read once for its frames, and not ahead."""
    chosen = [rows[number] for number in numbers if rows[number]["codec"] != "video"]
    found = [ByteRange(row["uri"], row["byte_offset"], row["byte_length"]) for row in chosen]
    return [one for one in found if ahead.is_far(one.uri)]
