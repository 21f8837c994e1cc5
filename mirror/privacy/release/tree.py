"""The files of a release: drives, traversals and layers of a dataset with redacted images, new ids and new times."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np
import pyarrow as pa

from mirror.dataset.content_hashes import ContentHashes
from mirror.dataset.images.binary_mask import rewrite_mask
from mirror.dataset.layout import Layout, manifest_sha256, read_manifest, seal
from mirror.dataset.redaction import REDACTION, current_redaction, newest_redaction
from mirror.dataset.store import Store
from mirror.dataset.taken_down import drop_images, group_by_traversal, read_take_downs
from mirror.errors import DatasetError
from mirror.ingest.tables import assign_frames
from mirror.privacy.log import LOG, ImageRecord, read_log, read_plate_region
from mirror.privacy.release.renaming import Renaming
from mirror.schema.documents import DriveDocument, ImageTotals, RecordingSource, Rig
from mirror.schema.files import conform, encode_table, read_json, read_table, write_bytes, write_json
from mirror.schema.links import require_inside
from mirror.schema.tables import (
    CALIBRATIONS,
    EGO_POSES,
    IMAGES,
    PASSES,
    Table,
)
from mirror.schema.tables import LAYER_TABLES as ALL_TABLES

LAYER_TABLES: Final[Mapping[str, Table]] = {kind: table for kind, table in ALL_TABLES.items() if kind != REDACTION}
"""The table of each kind of layer that a release has."""
FROM_IMAGES: Final = frozenset(("depth", "points"))
"""Kinds of layers that show what images show."""

ReadOriginal = Callable[[Mapping[str, Any]], bytes]


@dataclass(eq=False)
class TreeReport:
    """The counts of a release's written files.

    Attributes:
        records: the log, with the ids and times of the release.
        recorded: rows of the dataset's images, in the order of ``records``.
        manifests: content hashes of the recorded folders, by id in the release.
        traversals: ids in the release, by id in the dataset.
        withheld: number of images without a redacted version.
        left_out: layers that were derived from other images than the redacted ones.
    """

    records: list[ImageRecord] = field(default_factory=list)
    recorded: list[tuple[str, Mapping[str, Any]]] = field(default_factory=list)
    manifests: dict[str, str] = field(default_factory=dict)
    traversals: dict[str, str] = field(default_factory=dict)
    withheld: int = 0
    left_out: list[str] = field(default_factory=list)


def write_drive(
    source: Layout,
    target: Layout,
    drive: DriveDocument,
    traversals: Sequence[str],
    renaming: Renaming,
    advance: Callable[[int], object],
) -> TreeReport:
    """Write a drive and its traversals.

    Args:
        source: the dataset.
        target: the release.
        drive: the drive.
        traversals: ids of its traversals that the release has.
        renaming: ids and clock of the drive.
        advance: called with the number of images done since the last call.

    Raises:
        DatasetError: a traversal has images and no redacted ones, or a file is missing or has changed.
    """
    report = TreeReport(traversals={old: renaming.traversal(old) for old in traversals})
    hashes = {}
    for old, new in report.traversals.items():
        _write_recorded(source, target, old, new, read_rig(source, drive), renaming, report, advance)
        report.manifests[new] = _content(target, new)
        for kind, layer_source, version in source.layers(old):
            if kind in LAYER_TABLES:
                _write_layer(source, target, old, new, (kind, layer_source, version), renaming, report)
        hashes[f"traversal:{new}"] = manifest_sha256(target.recorded(new))
    _write_ledger(source, target, drive, renaming, report.traversals, hashes)
    return report


def _write_recorded(
    source: Layout,
    target: Layout,
    old: str,
    new: str,
    rig: Rig | None,
    renaming: Renaming,
    report: TreeReport,
    advance: Callable[[int], object],
) -> None:
    recorded, folder = source.recorded(old), target.recorded(new)
    gone = group_by_traversal(read_take_downs(Store(source.root))).get(old, frozenset())
    every = read_table(recorded / "images.parquet", IMAGES)
    rows = drop_images(every, gone)
    images = rows.slice(0, 0)
    total = 0
    newest = newest_redaction(source.layers(old))
    if rows.num_rows:
        if newest is None:
            raise DatasetError(
                f"{rows.num_rows} images have no redacted version", file=source.traversal(old),
                expected="a layer of redacted images", remedy=f"mirror deidentify {source.root} --plate-region REGION",
            )  # fmt: skip
        layer = source.layer(old, REDACTION, *newest)
        redacted = drop_images(read_table(layer / "images.parquet", IMAGES), gone)
        records = {record.key[1:]: record for record in read_log(layer / LOG)}
        report.withheld += rows.num_rows - redacted.num_rows
        original = {(row["camera"], row["timestamp_ns"]): row for row in rows.to_pylist()}
        hashes = ContentHashes(Store(source.root))
        out_rows = []
        for row in redacted.to_pylist():
            key = (row["camera"], row["timestamp_ns"])
            _require_source(hashes, records[key], original[key], layer / LOG)
            data = _read(source, row, row["sha256"])
            stamp = row["timestamp_ns"] + renaming.shift_ns
            name = f"{row['camera']}/{stamp}{'.png' if row['codec'] == 'png' else '.jpg'}"
            write_bytes(folder / name, data)
            out_rows.append({**row, "uri": f"traversals/{new}/recorded/{name}", "byte_offset": 0})
            change = {"traversal_id": new, "timestamp_ns": stamp, "source_sha256": None}
            report.records.append(records[key].model_copy(update=change))
            report.recorded.append((old, original[key]))
            total += len(data)
            advance(1)
        images = _table(out_rows, IMAGES)
        if images.num_rows < every.num_rows:
            images = renumber_frames(images, rig)
    files: dict[str, bytes] = {}
    poses = read_table(recorded / "ego_poses.parquet", EGO_POSES)
    calibrations = read_table(recorded / "calibrations.parquet", CALIBRATIONS)
    for table, data_rows in ((EGO_POSES, poses), (IMAGES, images), (CALIBRATIONS, calibrations)):
        name = f"{table.name}.parquet"
        files[name] = encode_table(renaming.table(data_rows, report.traversals), table)
        write_bytes(folder / name, files[name])
    seal(folder, files, derived_from={}, images=ImageTotals(count=images.num_rows, bytes=total))


def _require_source(hashes: ContentHashes, record: ImageRecord, row: Mapping[str, Any], log: Path) -> None:
    """Raise if an image was redacted from other bytes than those recorded now."""
    recorded = hashes.image_bytes(row) if row["sha256"] is None else row["sha256"].hex()
    if record.source_sha256 != recorded:
        problem = "does not state from which bytes an image was redacted"
        raise DatasetError(
            problem if record.source_sha256 is None else "an image was redacted from other bytes than those recorded",
            file=log, place="/".join(map(str, record.key)), expected=f"SHA-256 {recorded}",
            remedy="de-identify the dataset under another --version, which replaces this one",
        )  # fmt: skip


def _write_layer(
    source: Layout,
    target: Layout,
    old: str,
    new: str,
    layer: tuple[str, str, str],
    renaming: Renaming,
    report: TreeReport,
) -> None:
    kind, table = layer[0], LAYER_TABLES[layer[0]]
    folder, manifest = source.layer(old, *layer), read_manifest(source.layer(old, *layer))
    if manifest is None:
        return
    newest = newest_redaction(source.layers(old))
    if kind in FROM_IMAGES and manifest.derived_from.get(REDACTION) != current_redaction(source, old):
        report.left_out.append(f"{new}/{'/'.join(layer)}")
        return
    if kind == "masks" and layer[1] == (newest or ("",))[0] and layer[1:] != newest:
        # Masks of an older redaction do not fit the images of the newest.
        report.left_out.append(f"{new}/{'/'.join(layer)}")
        return
    table_rows = read_table(folder / f"{table.name}.parquet", table)
    out = target.layer(new, *layer)
    if "uri" in table_rows.column_names:
        rows = table_rows.to_pylist()
        known = {(record.camera, record.timestamp_ns) for record in report.records if record.traversal_id == new}
        kept = [row for row in rows if (row["camera"], row["timestamp_ns"] + renaming.shift_ns) in known]
        for row in kept:
            stem = f"{row['camera']}/{row['timestamp_ns'] + renaming.shift_ns}"
            # An image may have several masks of a layer.
            name = f"{stem}{'-' + row['kind'] if 'kind' in row else ''}{PurePosixPath(row['uri']).suffix}"
            data = _read(source, row, row["sha256"])
            if kind == "masks":
                # A photo may be saved as a mask.
                data = rewrite_mask(data, source.root / row["uri"])
                row |= {"sha256": hashlib.sha256(data).digest(), "byte_length": len(data)}
            write_bytes(out / name, data)
            row["uri"] = (out / name).relative_to(target.root).as_posix()
        table_rows = _table(kept, table)
    encoded = encode_table(renaming.table(table_rows, report.traversals), table)
    name = f"{table.name}.parquet"
    write_bytes(out / name, encoded)
    seal(out, {name: encoded}, derived_from={"recorded": _content(target, new)})


def _write_ledger(
    source: Layout,
    target: Layout,
    drive: DriveDocument,
    renaming: Renaming,
    traversals: Mapping[str, str],
    hashes: Mapping[str, str],
) -> None:
    passes = read_table(source.drive(drive.drive_id) / "passes.parquet", PASSES)
    ids = passes.column("traversal_id").to_pylist()
    kept = passes.filter(pa.array([value is None or value in traversals for value in ids]))
    ledger = encode_table(renaming.table(kept, traversals), PASSES)
    document = drive.model_copy(
        update={
            "drive_id": renaming.new_drive_id,
            "vehicle_id": renaming.new_vehicle_id,
            # The name of a recording, its size and its fingerprint identify the original.
            "source": RecordingSource(
                reader="release", name=renaming.new_drive_id, files=0, bytes=0, fingerprint="0" * 64
            ),
            "start_ns": drive.start_ns + renaming.shift_ns,
            "end_ns": drive.end_ns + renaming.shift_ns,
        }
    )
    folder = target.drive(renaming.new_drive_id)
    write_bytes(folder / "passes.parquet", ledger)
    write_json(folder / "drive.json", document)
    files = {"passes.parquet": ledger, "drive.json": (folder / "drive.json").read_bytes()}
    seal(folder, files, derived_from=hashes)


def read_plate_regions(layout: Layout, traversals: Iterable[str]) -> set[str | None]:
    """Read the plate regions of the newest redactions; None stands for a log without a region."""
    found = set()
    for traversal_id in traversals:
        newest = newest_redaction(layout.layers(traversal_id))
        if newest is not None:
            found.add(read_plate_region(layout.layer(traversal_id, REDACTION, *newest) / LOG))
    return found


def read_drives(layout: Layout) -> Iterator[tuple[DriveDocument, list[str]]]:
    """Yield the drives of a dataset with the ids of their traversals."""
    for drive_id in layout.drive_ids():
        drive = read_json(layout.drive(drive_id) / "drive.json", DriveDocument)
        manifest = read_manifest(layout.drive(drive_id))
        keys = () if manifest is None else manifest.derived_from
        yield drive, sorted(key.removeprefix("traversal:") for key in keys if key.startswith("traversal:"))


def _content(layout: Layout, traversal_id: str) -> str:
    manifest = read_manifest(layout.recorded(traversal_id))
    if manifest is None:
        raise DatasetError("missing", file=layout.recorded(traversal_id), expected="a complete folder")
    return manifest.content


def _read(layout: Layout, row: Mapping[str, Any], sha256: bytes) -> bytes:
    path = require_inside(layout.root, row["uri"])
    try:
        data = Store(layout.root).read_range(row["uri"], row.get("byte_offset", 0), row["byte_length"])
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror or error}", file=path) from error
    if hashlib.sha256(data).digest() != sha256:
        raise DatasetError(
            "the bytes are not those that were written", file=path, expected=f"SHA-256 {sha256.hex()}",
            remedy="write the layer again under another version",
        )  # fmt: skip
    return data


def _table(rows: Sequence[Mapping[str, Any]], table: Table) -> pa.Table:
    plain = pa.schema(
        [item.with_type(pa.string()) if pa.types.is_dictionary(item.type) else item for item in table.schema]
    )
    return conform(pa.Table.from_pylist([dict(row) for row in rows], schema=plain), table, file=table.place)


def renumber_frames(images: pa.Table, rig: Rig | None) -> pa.Table:
    """Number the frames that images form.

    An exposure of the reference camera that is absent has no frame.

    Args:
        images: rows of the images table.
        rig: the rig of the traversal; None: it has no cameras.
    """
    cameras = np.array(images.column("camera").cast(pa.string()).to_pylist(), dtype=object)
    stamps = images.column("timestamp_ns").to_numpy()
    rows = {name: np.flatnonzero(cameras == name) for name in sorted(set(cameras.tolist()))}
    rows = {name: own[np.argsort(stamps[own])] for name, own in rows.items()}
    frames = assign_frames({name: stamps[own] for name, own in rows.items()}, rig.reference_camera if rig else "")
    numbers: list[int | None] = [None] * images.num_rows
    for name, own in rows.items():
        for row, frame in zip(own.tolist(), frames[name]):
            numbers[row] = frame
    position = images.column_names.index("frame_index")
    return images.set_column(position, images.schema.field("frame_index"), pa.array(numbers, pa.int32()))


def read_rig(layout: Layout, drive: DriveDocument) -> Rig | None:
    """Return the rig of a drive; None if it has no cameras."""
    return None if drive.rig_id is None else read_json(layout.rig(drive.rig_id), Rig)
