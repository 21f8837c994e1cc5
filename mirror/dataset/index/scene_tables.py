"""The derived tables of one scene: recorded tables and layers of its traversals, with common keys and positions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Float64, Int64
from mirror.dataset.index.geoparquet import bounding_box, continuous, wkb_line
from mirror.dataset.index.inputs import TraversalInput
from mirror.dataset.layout import Layout
from mirror.dataset.redaction import REDACTION, newest_redaction
from mirror.dataset.taken_down import drop_images
from mirror.errors import DatasetError
from mirror.schema.files import TableWriter, read_table
from mirror.schema.index_tables import FRAMES, INDEX_BY_SCENE, TRAVERSALS
from mirror.schema.tables import BOXES, CALIBRATIONS, DEPTH, EGO_POSES, IMAGES, KEY, MASKS, POINTS, SHA256, Table

REDACTION_TABLE: Final = IMAGES
_POSITION: Final = ("longitude_deg", "latitude_deg", "x_m", "y_m")
_BEFORE_ALL: Final = -(2**63)
_REDACTED: Final = ("uri", "byte_offset", "byte_length", "codec", "video_pts", "sha256", "width_px", "height_px")


@dataclass(frozen=True)
class SceneTables:
    """The part of the index of one scene.

    Attributes:
        files: complete files with temporary names, by table; a table without rows has no file.
        row_groups: rows of the table ROW_GROUPS.
    """

    files: Mapping[str, Path]
    row_groups: Sequence[Mapping[str, Any]]


def write_scene_tables(
    layout: Layout,
    folder: Path,
    scene_id: str,
    traversals: Iterable[tuple[TraversalInput, Mapping[str, Any]]],
    add_traversal: Callable[[Mapping[str, Any]], None],
) -> SceneTables:
    """Derive the tables of one scene, traversal by traversal, with one traversal's tables in memory at a time.

    Args:
        layout: the dataset.
        folder: of the index's tables.
        scene_id: the scene.
        traversals: the scene's traversals, sorted by id, each with its accepted row of the ledger.
        add_traversal: called with each traversal's row of the table TRAVERSALS.

    Raises:
        DatasetError: a table is missing, or the poses do not cover an image.
        SchemaError: a table is broken.
    """
    writers: dict[str, TableWriter] = {}
    groups: Counter[str] = Counter()
    row_groups = []
    try:
        for traversal, ledger in traversals:
            own = _traversal_tables(layout, traversal)
            for table in INDEX_BY_SCENE:
                data = own[table.name]
                if not data.num_rows:
                    continue
                if table.name not in writers:
                    path = folder / table.name / f"{scene_id}.parquet"
                    writers[table.name] = TableWriter(path, table)
                writers[table.name].write(canonical_dictionaries(data, table))
                row_groups.append(_row_group(table, traversal, groups[table.name], data))
                groups[table.name] += 1
            add_traversal(_traversal_row(traversal, ledger, own))
        files = {name: writer.finish() for name, writer in writers.items()}
    except BaseException:
        for writer in writers.values():
            writer.abandon()
        raise
    return SceneTables(files, row_groups)


def canonical_dictionaries(data: pa.Table, table: Table) -> pa.Table:
    """Order the dictionaries of a table by first appearance, so that equal rows give equal bytes."""
    columns = [
        data.column(field.name).cast(pa.string()).combine_chunks().dictionary_encode().cast(KEY)
        if field.type == KEY
        else data.column(field.name).combine_chunks()
        for field in table.schema
    ]
    return pa.Table.from_arrays(columns, names=table.schema.names)


def plain_schema(table: Table) -> pa.Schema:
    """Return a table's schema with strings in place of dictionaries."""
    return pa.schema(
        [field.with_type(pa.string()) if pa.types.is_dictionary(field.type) else field for field in table.schema]
    )


def _traversal_tables(layout: Layout, traversal: TraversalInput) -> dict[str, pa.Table]:
    recorded = layout.recorded(traversal.traversal_id)
    poses = _sorted(read_table(recorded / "ego_poses.parquet", EGO_POSES), EGO_POSES)
    images = _redacted(layout, traversal, read_table(recorded / "images.parquet", IMAGES))
    images = _with_positions(traversal, _sorted(images, IMAGES), poses, recorded)
    gone = traversal.taken_down
    shown = drop_images(images, gone)
    tables = {
        "ego_poses": poses,
        "images": shown,
        "calibrations": _sorted(read_table(recorded / "calibrations.parquet", CALIBRATIONS), CALIBRATIONS),
        "frames": _frames(traversal, images, shown),
        "boxes": _layer_tables(layout, traversal, "boxes", BOXES),
        "masks": drop_images(_layer_tables(layout, traversal, "masks", MASKS), gone),
        "depth": drop_images(_layer_tables(layout, traversal, "depth", DEPTH), gone),
        "points": _layer_tables(layout, traversal, "points", POINTS),
    }
    return {name: _keyed(traversal, data) for name, data in tables.items()}


def _keyed(traversal: TraversalInput, data: pa.Table) -> pa.Table:
    keys = [pa.repeat(pa.scalar(value), data.num_rows) for value in (traversal.scene_id, traversal.traversal_id)]
    plain = [column.cast(pa.string()) if column.type == KEY else column for column in data.columns]
    return pa.Table.from_arrays([*keys, *plain], names=["scene_id", "traversal_id", *data.column_names])


def _sorted(data: pa.Table, table: Table) -> pa.Table:
    keys = {}
    for name in table.sorted_by:
        column = data.column(name)
        plain = column.cast(pa.string()) if column.type == KEY else column
        # An interval without a start sorts first.
        keys[name] = pc.fill_null(plain, _BEFORE_ALL) if plain.null_count else plain
    return data.take(pc.sort_indices(pa.table(keys), sort_keys=[(name, "ascending") for name in keys]))


def _layer_tables(layout: Layout, traversal: TraversalInput, kind: str, table: Table) -> pa.Table:
    """All layers of one kind; rows with equal keys are ordered by source and version."""
    found = [
        read_table(layout.layer(traversal.traversal_id, kind, source, version) / f"{table.name}.parquet", table)
        for layer_kind, source, version in traversal.layers
        if layer_kind == kind
    ]
    return _sorted(pa.concat_tables(found), table) if found else table.schema.empty_table()


def _redacted(layout: Layout, traversal: TraversalInput, images: pa.Table) -> pa.Table:
    """Replace the recorded bytes in the images table with those of the newest redaction layer."""
    newest = newest_redaction(traversal.layers)
    if newest is None:
        return images.append_column("source_sha256", pa.nulls(images.num_rows, SHA256))
    file = layout.layer(traversal.traversal_id, REDACTION, *newest) / f"{REDACTION_TABLE.name}.parquet"
    redaction = read_table(file, REDACTION_TABLE)
    position = {key: row for row, key in enumerate(_image_keys(images))}
    target = []
    for key in _image_keys(redaction):
        if key not in position:
            raise DatasetError(
                "a redacted image was never recorded",
                file=file,
                place=f"camera {key[0]}, timestamp_ns {key[1]}",
                expected="camera and timestamp_ns of a row of the recorded images",
                remedy="write the layer again",
            )
        target.append(position[key])
    replaced = np.zeros(images.num_rows, np.bool_)
    replaced[target] = True
    # Row r of the result is row take[r] of the two tables concatenated.
    take = np.arange(images.num_rows)
    take[target] = images.num_rows + np.arange(redaction.num_rows)
    result = images
    for name in _REDACTED:
        kind = images.column(name).type
        plain = pa.string() if kind == KEY else kind
        parts = [*images.column(name).cast(plain).chunks, *redaction.column(name).cast(plain).chunks]
        both = pa.chunked_array(parts, type=plain)
        result = result.set_column(result.column_names.index(name), name, both.take(pa.array(take)))
    mask = pa.array(replaced)
    privacy = pc.if_else(mask, "redacted", images.column("privacy").cast(pa.string()))
    result = result.set_column(result.column_names.index("privacy"), "privacy", privacy)
    return result.append_column("source_sha256", pc.if_else(mask, images.column("sha256"), pa.scalar(None, SHA256)))


def _image_keys(images: pa.Table) -> list[tuple[str, int]]:
    return list(zip(images.column("camera").to_pylist(), images.column("timestamp_ns").to_pylist()))


def _with_positions(traversal: TraversalInput, images: pa.Table, poses: pa.Table, folder: Path) -> pa.Table:
    """Add the ego position at mid-exposure to the images, interpolated linearly between the poses."""
    query = images.column("timestamp_ns").to_numpy()
    stamps = poses.column("timestamp_ns").to_numpy()
    if len(query):
        outside = (query < stamps[0]) | (query > stamps[-1]) if len(stamps) else np.ones(len(query), np.bool_)
        if outside.any():
            row = int(np.argmax(outside))
            raise DatasetError(
                f"the poses of {traversal.traversal_id} do not cover an image",
                file=folder / "images.parquet",
                place=f"camera {images.column('camera')[row]}, timestamp_ns {query[row]}",
                expected=f"a stamp from {stamps[0]} to {stamps[-1]}" if len(stamps) else "poses",
                remedy=f"ingest drive {traversal.drive.drive_id} again",
            )
    geodetic = poses.num_rows > 0 and poses.column("longitude_deg").null_count == 0
    for name, source in zip(_POSITION, ("longitude_deg", "latitude_deg", "tx_m", "ty_m")):
        if name in ("longitude_deg", "latitude_deg") and not geodetic:
            images = images.append_column(name, pa.nulls(images.num_rows, pa.float64()))
            continue
        values = _interpolate(query, stamps, poses.column(source).to_numpy(), longitude=name == "longitude_deg")
        images = images.append_column(name, pa.array(values))
    return images


def _interpolate(query_ns: Int64, stamps_ns: Int64, values: Float64, *, longitude: bool) -> Float64:
    if not len(query_ns):
        return np.empty(0)
    # Timestamps relative to the first are exact in float64; Unix nanoseconds are not.
    times = (stamps_ns - stamps_ns[0]).astype(np.float64)
    at = (query_ns - stamps_ns[0]).astype(np.float64)
    found = np.interp(at, times, continuous(values) if longitude else values)
    return (found + 180.0) % 360.0 - 180.0 if longitude and (np.abs(found) > 180.0).any() else found


def _frames(traversal: TraversalInput, images: pa.Table, shown: pa.Table) -> pa.Table:
    """The exposures of the rig's reference camera, each with the number of images in its frame.

    A frame whose reference image was taken down keeps its number and its instant; one without images is left out.
    """
    if traversal.rig is None or not images.num_rows:
        return FRAMES.schema.empty_table().drop_columns(["scene_id", "traversal_id"])
    framed = images.filter(pc.is_valid(images.column("frame_index")))
    frames, counts = np.unique(shown.column("frame_index").drop_null().to_numpy(), return_counts=True)
    framed = framed.filter(pc.is_in(framed.column("frame_index"), value_set=pa.array(frames, pa.int32())))
    reference = framed.filter(pc.equal(framed.column("camera").cast(pa.string()), traversal.rig.reference_camera))
    reference = reference.sort_by("frame_index")
    frame_index = reference.column("frame_index").to_numpy()
    return pa.table(
        {
            "frame_index": reference.column("frame_index"),
            "timestamp_ns": reference.column("timestamp_ns"),
            "images": pa.array(counts[np.searchsorted(frames, frame_index)], pa.int32()),
            **{name: reference.column(name) for name in _POSITION},
        }
    )


def _row_group(table: Table, traversal: TraversalInput, number: int, data: pa.Table) -> dict[str, Any]:
    row: dict[str, Any] = {
        "table": table.name,
        "scene_id": traversal.scene_id,
        "traversal_id": traversal.traversal_id,
        "row_group": number,
        "rows": data.num_rows,
    }
    for column, low, high in (
        ("timestamp_ns", "start_ns", "end_ns"),
        ("longitude_deg", "longitude_min_deg", "longitude_max_deg"),
        ("latitude_deg", "latitude_min_deg", "latitude_max_deg"),
    ):
        extent = pc.min_max(data.column(column)).as_py() if column in data.column_names else {"min": None, "max": None}
        row[low], row[high] = extent["min"], extent["max"]
    return row


def _traversal_row(
    traversal: TraversalInput, ledger: Mapping[str, Any], tables: Mapping[str, pa.Table]
) -> dict[str, Any]:
    images = tables["images"]
    points = _driven_line(tables["ego_poses"], ledger["entry_ns"], ledger["exit_ns"])
    own = {
        "vehicle_id": traversal.drive.vehicle_id,
        "vehicle_type": traversal.drive.vehicle_type,
        "rig_id": traversal.drive.rig_id,
        "has_images": images.num_rows > 0,
        "images": images.num_rows,
        "frames": tables["frames"].num_rows,
        "cameras": sorted(set(images.column("camera").to_pylist())),
        "layers": [f"{kind}/{source}@{version}" for kind, source, version in traversal.layers],
        "geometry": None if points is None else wkb_line(points),
        "bbox": None if points is None else bounding_box(points),
    }
    return {name: own[name] if name in own else ledger[name] for name in TRAVERSALS.schema.names}


def _driven_line(poses: pa.Table, entry_ns: int, exit_ns: int) -> Float64 | None:
    """Longitude and latitude (N, 2) from entry to exit, with interpolated ends; None in a local frame."""
    if not poses.num_rows or poses.column("longitude_deg").null_count:
        return None
    stamps = poses.column("timestamp_ns").to_numpy()
    inside = stamps[(stamps > entry_ns) & (stamps < exit_ns)]
    at = np.concatenate([[entry_ns], inside, [exit_ns]]).astype(np.int64)
    lon = _interpolate(at, stamps, poses.column("longitude_deg").to_numpy(), longitude=True)
    return np.column_stack(
        [continuous(lon), _interpolate(at, stamps, poses.column("latitude_deg").to_numpy(), longitude=False)]
    )
