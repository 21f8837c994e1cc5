"""The files that the documents, manifests and tables of a dataset name; no folder is walked for others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any, Final, NamedTuple, TypeAlias

from mirror.dataset.layout import MANIFEST, Layout, read_manifest
from mirror.dataset.redaction import REDACTION, newest_redaction
from mirror.dataset.store import Store
from mirror.dataset.taken_down import read_take_downs
from mirror.errors import DatasetError
from mirror.schema.documents import DriveDocument, Manifest, Rig, SplitDocument
from mirror.schema.files import read_json, read_table
from mirror.schema.links import require_inside
from mirror.schema.tables import IMAGES, LAYER_TABLES, Table
from mirror.schema.take_downs import TAKE_DOWNS

ImageKey: TypeAlias = tuple[str, str, int]
"""Identifies an image, whatever file shows it: traversal, camera, timestamp_ns."""

RECORDED: Final = "recorded"
"""The layer of the recorded images in `ImageFile`."""

RELEASE_DOCUMENTS: Final = ("release.json", "DATASHEET.md", "LICENCE.txt", "redaction_log.jsonl")
"""Documents, datasheet, licence and log of a release, which is a dataset too."""

_DOCUMENTS: Final = ("dataset.json", "rois.geojson", TAKE_DOWNS, *RELEASE_DOCUMENTS)
_TABLE_FILES: Final = (".parquet", ".json", ".jsonl")
"""Endings of what a manifest may name; images are named by tables, which say what they show."""


class ImageFile(NamedTuple):
    """A file, or a part of a file, that shows an image.

    Attributes:
        key: the image.
        layer: `RECORDED`, or ``kind/source@version``.
        name: path relative to the dataset, or a URL.
        offset: first byte.
        length: number of bytes.
        codec: jpeg, png or video.
        pts: presentation time stamp of the frame in a video; None: not a video.
        sha256: SHA-256 of the bytes, as the table states it, in hexadecimal; None: not stated.
        size: width and height in pixels.
        is_redacted: whether faces and plates were removed, here or at the source, as the table states it.
    """

    key: ImageKey
    layer: str
    name: str
    offset: int
    length: int
    codec: str
    pts: int | None
    sha256: str | None
    size: tuple[int, int]
    is_redacted: bool = False


@dataclass(eq=False)
class DatasetFiles:
    """Files that a dataset names.

    Attributes:
        documents: documents, manifests and tables with their SHA-256, as a manifest states it; None: not stated.
        static_masks: masks of rigs.
        masks: masks of images, by layer, with their SHA-256.
        images: files that show images, of the recording and of every layer.
        layers: layers of each traversal, as ``kind/source@version``.
        taken_down: images that were taken down, with the SHA-256 of the bytes that showed them. `images` has the files
            that still hold such bytes.
    """

    documents: dict[str, str | None] = field(default_factory=dict)
    static_masks: list[str] = field(default_factory=list)
    masks: dict[str, str] = field(default_factory=dict)
    images: list[ImageFile] = field(default_factory=list)
    layers: dict[str, list[str]] = field(default_factory=dict)
    taken_down: dict[ImageKey, tuple[str, ...]] = field(default_factory=dict)

    @property
    def names(self) -> frozenset[str]:
        """Every file that is named, relative to the dataset."""
        return frozenset((*self.documents, *self.static_masks, *self.masks, *(one.name for one in self.images)))


def list_dataset_files(layout: Layout) -> DatasetFiles:
    """List the files that a dataset names, except the files of its index.

    Raises:
        DatasetError: a table is missing, a manifest names a file that is no table, or a path leads out of the folder to
            which its table belongs.
        SchemaError: a document or table is broken.
    """
    found = DatasetFiles()
    store = Store(layout.root)
    found.taken_down = {one.key: one.sha256 for one in read_take_downs(store).images}
    for name in _DOCUMENTS:
        if require_inside(layout.root, name).is_file():
            found.documents[name] = None
    rigs = set()
    for drive_id in layout.drive_ids():
        folder = layout.drive(drive_id)
        manifest = _add_folder(layout, f"drives/{drive_id}", found)
        rigs.add(read_json(folder / "drive.json", DriveDocument).rig_id)
        for key in sorted(manifest.derived_from):
            if key.startswith("traversal:"):
                _add_traversal(layout, key.removeprefix("traversal:"), found)
    for rig_id in sorted(rigs - {None}, key=str):
        _add_rig(layout, str(rig_id), found)
    for path in sorted((layout.root / "splits").glob("*.json")):
        if not path.name.startswith("."):
            name = read_json(require_inside(layout.root, f"splits/{path.name}"), SplitDocument).name
            found.documents[f"splits/{name}.json"] = None
    for path in sorted((layout.root / "maps").glob(f"*/{MANIFEST}")):
        _add_folder(layout, f"maps/{path.parent.name}", found)
    found.images = [one for one in found.images if one.key not in found.taken_down or _has_bytes(store, one)]
    return found


def _has_bytes(store: Store, one: ImageFile) -> bool:
    """Return whether a file still holds an image: what was purged is missing, or zeros in an archive."""
    if _is_elsewhere(one.name):
        return True
    try:
        return any(store.read_range(one.name, one.offset, one.length))
    except FileNotFoundError:
        return False


def _add_traversal(layout: Layout, traversal_id: str, found: DatasetFiles) -> None:
    place = f"traversals/{traversal_id}"
    _add_folder(layout, f"{place}/{RECORDED}", found)
    found.images += _image_files(layout, traversal_id, RECORDED, IMAGES)
    found.layers[traversal_id] = []
    for kind, source, version in layout.layers(traversal_id):
        table, layer = LAYER_TABLES.get(kind), f"{kind}/{source}@{version}"
        if table is None:
            # No program of this version reads it, so nothing says what it shows.
            continue
        found.layers[traversal_id].append(layer)
        _add_folder(layout, f"{place}/layers/{layer}", found)
        if kind == "masks":
            for row in _rows(layout, traversal_id, layer, table):
                name = _own_file(layout, f"{place}/layers/{layer}", row["uri"])
                found.masks[name] = row["sha256"].hex()
        elif "uri" in table.schema.names:
            found.images += _image_files(layout, traversal_id, layer, table)


def _image_files(layout: Layout, traversal_id: str, layer: str, table: Table) -> Iterator[ImageFile]:
    folder = _folder(traversal_id, layer)
    for row in _rows(layout, traversal_id, layer, table):
        uri = row["uri"] if _is_elsewhere(row["uri"]) else _own_file(layout, folder, row["uri"])
        digest = row["sha256"]
        yield ImageFile(
            (traversal_id, row["camera"], row["timestamp_ns"]),
            layer,
            uri,
            row.get("byte_offset", 0),
            row["byte_length"],
            row.get("codec", "png"),
            row.get("video_pts"),
            None if digest is None else digest.hex(),
            (row["width_px"], row["height_px"]),
            row.get("privacy") == "redacted",
        )


def _rows(layout: Layout, traversal_id: str, layer: str, table: Table) -> list[dict[str, Any]]:
    path = require_inside(layout.root, f"{_folder(traversal_id, layer)}/{table.name}.parquet")
    rows: list[dict[str, Any]] = read_table(path, table).to_pylist()
    return rows


def _folder(traversal_id: str, layer: str) -> str:
    return f"traversals/{traversal_id}/{layer if layer == RECORDED else f'layers/{layer}'}"


def _is_elsewhere(uri: str) -> bool:
    return "://" in uri or uri.startswith("/")


def _own_file(layout: Layout, folder: str, uri: str) -> str:
    """The path of a file that a table names, which must lie in the table's own folder."""
    if _is_elsewhere(uri) or ".." in PurePosixPath(uri).parts or not uri.startswith(f"{folder}/"):
        raise DatasetError(
            f"the table names the file {uri}",
            file=layout.root / folder,
            expected=f"files below {folder}",
            remedy="write the layer again, or ingest the drive again",
        )
    require_inside(layout.root, uri)
    return uri


def _add_folder(layout: Layout, folder: str, found: DatasetFiles) -> Manifest:
    """Add the manifest of a folder, and what it names."""
    path = require_inside(layout.root, f"{folder}/{MANIFEST}")
    manifest = read_manifest(path.parent)
    if manifest is None:
        raise DatasetError("missing", file=path, expected="a complete folder", remedy="ingest the drive again")
    found.documents[f"{folder}/{MANIFEST}"] = None
    for name, entry in manifest.files.items():
        if PurePosixPath(name).suffix not in _TABLE_FILES:
            raise DatasetError(
                f"the manifest names {name}, which is no table: nothing states which images it shows",
                file=path,
                expected=f"files that end with {', '.join(_TABLE_FILES)}",
                remedy="write the layer again without this file",
            )
        require_inside(layout.root, f"{folder}/{name}")
        found.documents[f"{folder}/{name}"] = entry.sha256
    return manifest


def _add_rig(layout: Layout, rig_id: str, found: DatasetFiles) -> None:
    found.documents[f"rigs/{rig_id}.json"] = None
    rig = read_json(require_inside(layout.root, f"rigs/{rig_id}.json"), Rig)
    for camera in rig.cameras:
        if camera.static_mask is not None:
            found.static_masks.append(_own_file(layout, "rigs", f"rigs/{camera.static_mask}"))


def newest_of(layers: Mapping[str, list[str]], traversal_id: str) -> str | None:
    """Return the redaction layer that replaces the recorded images of a traversal; None without such a layer."""
    parts = [(kind, *name.split("@", 1)) for kind, _, name in (one.partition("/") for one in layers[traversal_id])]
    newest = newest_redaction((kind, source, version) for kind, source, version in parts)
    return None if newest is None else f"{REDACTION}/{newest[0]}@{newest[1]}"
