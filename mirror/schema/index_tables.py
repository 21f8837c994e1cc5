"""The tables of the index: derived from all others, with the keys ``scene_id`` and ``traversal_id`` in front.

As in `mirror.schema.tables`, the pyarrow schemas are the specification, and their words are a part of each file.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import pyarrow as pa

from mirror.schema.tables import (
    BBOX,
    BOXES,
    CALIBRATIONS,
    DEPTH,
    EGO_POSES,
    IMAGES,
    KEY,
    MASKS,
    PASSES,
    POINTS,
    SHA256,
    Table,
    column,
)

_KEYS: Final = [
    column("scene_id", KEY, "The scene."),
    column("traversal_id", KEY, "The traversal."),
]


def _indexed(table: Table, *extra: pa.Field) -> Table:
    return Table(
        name=table.name,
        row=table.row,
        place=f"index/<segment>/{table.name}/<scene_id>.parquet",
        schema=pa.schema([*_KEYS, *table.schema, *extra]),
        sorted_by=("traversal_id", *table.sorted_by),
    )


SCENES: Final = Table(
    name="scenes",
    row="one scene: a region of interest and what was recorded in it (GeoParquet)",
    place="index/<segment>/scenes.parquet",
    schema=pa.schema(
        [
            column("scene_id", pa.string(), "The scene."),
            column("city", pa.string(), "As given with the ROI.", null=True),
            column(
                "scene_type", pa.string(), "`urban`, `highway`, `rural`, `campus`, as given with the ROI.", null=True
            ),
            column("frame", pa.string(), "Name of the local metric frame; null: WGS 84.", null=True),
            column("longitude_deg", pa.float64(), "ROI centre, WGS 84.", null=True),
            column("latitude_deg", pa.float64(), "ROI centre, WGS 84.", null=True),
            column("x_m", pa.float64(), "ROI centre in its local metric frame.", null=True),
            column("y_m", pa.float64(), "ROI centre in its local metric frame.", null=True),
            column("height_m", pa.float64(), "Height of the world's origin above the ellipsoid."),
            column("radius_m", pa.float64(), "ROI radius."),
            column("traversals", pa.int32(), "Accepted passes."),
            column("drives", pa.int32(), "Drives with at least one accepted pass."),
            column("images", pa.int64(), "Pictures."),
            column("duration_s", pa.float64(), "Sum over the traversals."),
            column(
                "geometry",
                pa.binary(),
                "The ROI as WKB polygon (64 vertices a quarter), lon/lat; null in a local frame.",
                null=True,
            ),
            column("bbox", BBOX, "Bounding box covering of `geometry`.", null=True),
        ]
    ),
    sorted_by=("scene_id",),
)

TRAVERSALS: Final = Table(
    name="traversals",
    row="one accepted pass of a drive through a scene (GeoParquet)",
    place="index/<segment>/traversals.parquet",
    schema=pa.schema(
        [
            column("scene_id", pa.string(), "The scene."),
            column("traversal_id", pa.string(), "`scene.drive.entry_ms`."),
            column("drive_id", pa.string(), "The drive."),
            column("vehicle_id", pa.string(), "Pseudonym of the vehicle."),
            column("vehicle_type", pa.string(), "Make or class of the vehicle."),
            column("rig_id", pa.string(), "`rigs/<rig_id>.json`; null for a poses-only drive.", null=True),
            *[
                field
                for field in PASSES.schema
                if field.name
                in {
                    "entry_ns",
                    "exit_ns",
                    "entry_kind",
                    "exit_kind",
                    "duration_s",
                    "path_m",
                    "overlap",
                    "closest_m",
                    "mean_speed_mps",
                    "heading_in_deg",
                    "heading_out_deg",
                    "light",
                    "light_source",
                    "weather",
                    "weather_source",
                }
            ],
            column("has_images", pa.bool_(), "False for a poses-only drive."),
            column("images", pa.int64(), "Pictures."),
            column("frames", pa.int64(), "Frames of the reference camera."),
            column("cameras", pa.list_(pa.string()), "Cameras with pictures."),
            column("layers", pa.list_(pa.string()), "`kind/source@version` of every layer."),
            column(
                "geometry", pa.binary(), "The driven line as WKB LineString, lon/lat; null in a local frame.", null=True
            ),
            column("bbox", BBOX, "Bounding box covering of `geometry`.", null=True),
        ]
    ),
    sorted_by=("scene_id", "traversal_id"),
)

FRAMES: Final = Table(
    name="frames",
    row="one instant of the rig: an exposure of the reference camera",
    place="index/<segment>/frames/<scene_id>.parquet",
    schema=pa.schema(
        [
            *_KEYS,
            column("frame_index", pa.int32(), "Counts from 0 within the traversal."),
            column("timestamp_ns", pa.int64(), "Mid-exposure of the reference camera."),
            column("images", pa.int32(), "Cameras with a picture in this frame."),
            column("longitude_deg", pa.float64(), "Ego position, WGS 84; null in a local frame.", null=True),
            column("latitude_deg", pa.float64(), "Ego position, WGS 84; null in a local frame.", null=True),
            column("x_m", pa.float64(), "Ego position, world x."),
            column("y_m", pa.float64(), "Ego position, world y."),
        ]
    ),
    sorted_by=("traversal_id", "frame_index"),
)

INDEX_IMAGES: Final = _indexed(
    IMAGES,
    column("source_sha256", SHA256, "SHA-256 of the bytes as recorded, where a redaction replaced them.", null=True),
    column("longitude_deg", pa.float64(), "Ego position at mid-exposure, WGS 84; null in a local frame.", null=True),
    column("latitude_deg", pa.float64(), "Ego position at mid-exposure, WGS 84; null in a local frame.", null=True),
    column("x_m", pa.float64(), "Ego position at mid-exposure, world x."),
    column("y_m", pa.float64(), "Ego position at mid-exposure, world y."),
)
INDEX_EGO_POSES: Final = _indexed(EGO_POSES)
INDEX_CALIBRATIONS: Final = _indexed(CALIBRATIONS)
INDEX_BOXES: Final = _indexed(BOXES)
INDEX_MASKS: Final = _indexed(MASKS)
INDEX_DEPTH: Final = _indexed(DEPTH)
INDEX_POINTS: Final = _indexed(POINTS)
INDEX_PASSES: Final = Table(
    name="passes",
    row=PASSES.row,
    place="index/<segment>/passes.parquet",
    schema=PASSES.schema,
    sorted_by=PASSES.sorted_by,
)

ROW_GROUPS: Final = Table(
    name="row_groups",
    row="one row group of an index table, that is one traversal's rows, and what a query can skip it by",
    place="index/<segment>/row_groups.parquet",
    schema=pa.schema(
        [
            column("table", KEY, "The index table."),
            # Its words are a part of the bytes, and the bytes of datasets of earlier versions: they leave the segment out.
            column("scene_id", KEY, "Its scene: the file `index/<table>/<scene_id>.parquet`."),
            column("traversal_id", pa.string(), "The traversal whose rows these are."),
            column("row_group", pa.int32(), "Position of the row group in the file."),
            column("rows", pa.int64(), "Number of rows, never 0."),
            column("start_ns", pa.int64(), "Smallest `timestamp_ns`; null: the table has none.", null=True),
            column("end_ns", pa.int64(), "Largest `timestamp_ns`.", null=True),
            column("longitude_min_deg", pa.float64(), "Null: the table or the scene has no such column.", null=True),
            column("longitude_max_deg", pa.float64(), "Largest longitude.", null=True),
            column("latitude_min_deg", pa.float64(), "Smallest latitude.", null=True),
            column("latitude_max_deg", pa.float64(), "Largest latitude.", null=True),
        ]
    ),
    sorted_by=("table", "scene_id", "row_group"),
)

INDEX_GLOBAL: Final[Sequence[Table]] = (SCENES, TRAVERSALS, INDEX_PASSES, ROW_GROUPS)
INDEX_BY_SCENE: Final[Sequence[Table]] = (
    FRAMES,
    INDEX_IMAGES,
    INDEX_EGO_POSES,
    INDEX_CALIBRATIONS,
    INDEX_BOXES,
    INDEX_MASKS,
    INDEX_DEPTH,
    INDEX_POINTS,
)
