"""The tables of a dataset: these pyarrow schemas are the specification.

Every field has its documentation in the field metadata; ``python -m mirror.schema.document`` generates
``docs/schema.md`` from it. The metadata is a part of each Parquet file: other words change the bytes and hashes of new
files, so change them only with the schema version. Recorded and layer tables lie in a traversal's folder; index tables
are derived from them, with the keys ``scene_id`` and ``traversal_id`` in front.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import pyarrow as pa

KEY: Final = pa.dictionary(pa.int32(), pa.string())
SHA256: Final = pa.binary(32)
BBOX: Final = pa.struct([(name, pa.float64()) for name in ("xmin", "ymin", "xmax", "ymax")])

ADDED: Final[Mapping[str, pa.DataType]] = {"attributes": pa.list_(pa.string())}
"""Columns that a later minor version of the schema added; a table without one is read with nulls there."""


@dataclass(frozen=True)
class Table:
    """The specification of one table.

    Attributes:
        name: file stem and name in the API.
        row: a description of one row.
        place: path of the file, relative to the dataset's root.
        schema: the pyarrow schema; each field has its documentation under the metadata key ``doc``.
        sorted_by: the columns that order the rows.
    """

    name: str
    row: str
    place: str
    schema: pa.Schema
    sorted_by: tuple[str, ...]


def _field(name: str, kind: pa.DataType, doc: str, *, null: bool = False) -> pa.Field:
    return pa.field(name, kind, nullable=null, metadata={"doc": doc})


def _pose(src: str, dst: str) -> list[pa.Field]:
    what = f"{dst}_SE3_{src}: maps points of the {src} frame into the {dst} frame"
    return [
        _field("qw", pa.float64(), f"Unit quaternion, scalar part, >= 0, of {what}."),
        _field("qx", pa.float64(), "Unit quaternion, x."),
        _field("qy", pa.float64(), "Unit quaternion, y."),
        _field("qz", pa.float64(), "Unit quaternion, z."),
        _field("tx_m", pa.float64(), f"Translation x, in the {dst} frame."),
        _field("ty_m", pa.float64(), f"Translation y, in the {dst} frame."),
        _field("tz_m", pa.float64(), f"Translation z, in the {dst} frame."),
    ]


EGO_POSES: Final = Table(
    name="ego_poses",
    row="one pose of the vehicle, as recorded and cleaned, from 1 s before the entry to 1 s after the exit",
    place="traversals/<traversal_id>/recorded/ego_poses.parquet",
    schema=pa.schema(
        [
            _field("timestamp_ns", pa.int64(), "Unix time, UTC."),
            *_pose("ego", "world"),
            _field("longitude_deg", pa.float64(), "WGS 84; null in a local metric frame.", null=True),
            _field("latitude_deg", pa.float64(), "WGS 84; null in a local metric frame.", null=True),
            _field("height_m", pa.float64(), "Above the WGS 84 ellipsoid; null where the source has none.", null=True),
            _field("sigma_m", pa.float64(), "Horizontal 1-sigma of the fix, where the source states it.", null=True),
            _field(
                "orientation",
                KEY,
                "Where the rotation comes from: `recorded`, or `course` (direction of travel, level).",
            ),
        ]
    ),
    sorted_by=("timestamp_ns",),
)

IMAGES: Final = Table(
    name="images",
    row="one image of one camera",
    place="traversals/<traversal_id>/recorded/images.parquet",
    schema=pa.schema(
        [
            _field("camera", KEY, "Camera name, canonical where the rig maps to it."),
            _field("timestamp_ns", pa.int64(), "Mid-exposure, Unix time, UTC: the instant of the image's pose."),
            _field("exposure_start_ns", pa.int64(), "Start of the exposure of the first row."),
            _field("exposure_end_ns", pa.int64(), "End of the exposure of the last row."),
            _field(
                "frame_index",
                pa.int32(),
                "The frame this picture belongs to (its traversal's frames count from 0); null: no frame is within half a period.",
                null=True,
            ),
            _field("width_px", pa.int32(), "Width of the stored raster."),
            _field("height_px", pa.int32(), "Height of the stored raster."),
            _field(
                "uri", pa.string(), "Where the bytes lie: relative to the dataset's root, or absolute through fsspec."
            ),
            _field("byte_offset", pa.int64(), "First byte within the uri."),
            _field("byte_length", pa.int64(), "Number of bytes; for a video frame, of the whole video."),
            _field("codec", KEY, "`jpeg`, `png`, or `video` (then `video_pts` selects the frame)."),
            _field("video_pts", pa.int64(), "Presentation time stamp in the video's time base.", null=True),
            _field(
                "sha256",
                SHA256,
                "SHA-256 of the bytes; null when hashing was switched off at ingest, or the pictures lie elsewhere.",
                null=True,
            ),
            _field("privacy", KEY, "`raw`, or `redacted` where the source delivered pictures already de-identified."),
        ]
    ),
    sorted_by=("camera", "timestamp_ns"),
)

CALIBRATIONS: Final = Table(
    name="calibrations",
    row="one camera's intrinsics and mounting, of one stage, over a validity interval",
    place="traversals/<traversal_id>/recorded/calibrations.parquet",
    schema=pa.schema(
        [
            _field("vehicle_id", KEY, "Pseudonym of the vehicle."),
            _field("drive_id", KEY, "The drive in which it was valid."),
            _field("camera", KEY, "Camera name."),
            _field("stage", KEY, "`factory`, `online` or `refined`."),
            _field("valid_from_ns", pa.int64(), "First instant of validity; null: from the beginning.", null=True),
            _field("valid_to_ns", pa.int64(), "Last instant of validity; null: without end.", null=True),
            _field("model", KEY, "`pinhole`, `brown_conrady`, `rational`, `kannala_brandt` or `f_theta`."),
            _field("width_px", pa.int32(), "Width of the calibrated raster."),
            _field("height_px", pa.int32(), "Height of the calibrated raster."),
            _field("fx_px", pa.float64(), "Focal length x (f-theta: 1)."),
            _field("fy_px", pa.float64(), "Focal length y (f-theta: 1)."),
            _field("cx_px", pa.float64(), "Principal point x; the centre of the first pixel is at 0.5."),
            _field("cy_px", pa.float64(), "Principal point y; the centre of the first pixel is at 0.5."),
            _field("distortion", pa.list_(pa.float64()), "Coefficients in the order of the model's documentation."),
            *_pose("camera", "ego"),
            _field(
                "time_offset_ns",
                pa.int64(),
                "Added to the camera's stamps to give the vehicle's clock; already applied to the images table.",
            ),
            _field(
                "shutter_direction",
                KEY,
                "`global`, `top_to_bottom`, `bottom_to_top`, `left_to_right`, `right_to_left`.",
            ),
            _field(
                "readout_ns",
                pa.int64(),
                "From the first row's to the last row's start of exposure; 0 for a global shutter.",
            ),
            _field(
                "covariance",
                pa.list_(pa.float64()),
                "6x6 row-major, of the mounting: rotation (rad) then translation (m).",
                null=True,
            ),
            _field("method", pa.string(), "How it was obtained.", null=True),
        ]
    ),
    sorted_by=("camera", "stage", "valid_from_ns"),
)

BOXES: Final = Table(
    name="boxes",
    row="one 3D box of one object at one instant",
    place="traversals/<traversal_id>/layers/boxes/<source>@<version>/boxes.parquet",
    schema=pa.schema(
        [
            _field("timestamp_ns", pa.int64(), "Unix time, UTC, of the instant that the box describes."),
            _field("track_id", pa.string(), "The object, within the traversal and source."),
            _field("category", KEY, "Class in the source's own words, or MIRROR's where it maps."),
            *_pose("box", "ego"),
            _field("length_m", pa.float64(), "Extent along the box's x."),
            _field("width_m", pa.float64(), "Extent along the box's y."),
            _field("height_m", pa.float64(), "Extent along the box's z."),
            _field("vx_mps", pa.float64(), "Velocity over ground along the ego frame's x; null: unknown.", null=True),
            _field("vy_mps", pa.float64(), "Velocity over ground along the ego frame's y.", null=True),
            _field("vz_mps", pa.float64(), "Velocity over ground along the ego frame's z.", null=True),
            _field(
                "score",
                pa.float64(),
                "Confidence, 0 to 1; null for a label made by a person or a simulator.",
                null=True,
            ),
            _field(
                "attributes",
                ADDED["attributes"],
                "States of the object in the source's own words, such as `vehicle.parked`; null: not stated. Since 1.1.",
                null=True,
            ),
            _field("source", KEY, "Who made the box."),
            _field("source_version", KEY, "Version of the source."),
        ]
    ),
    sorted_by=("timestamp_ns", "track_id"),
)

MASKS: Final = Table(
    name="masks",
    row="one mask of one image",
    place="traversals/<traversal_id>/layers/masks/<source>@<version>/masks.parquet",
    schema=pa.schema(
        [
            _field("camera", KEY, "Camera of the masked picture."),
            _field("timestamp_ns", pa.int64(), "Mid-exposure of the masked picture."),
            _field("kind", KEY, "`dynamic`, `ego`, `sky`, `instance`: what non-zero pixels are."),
            _field("uri", pa.string(), "The mask's PNG (8 bit grey), relative to the dataset's root."),
            _field("byte_length", pa.int64(), "Its size."),
            _field("sha256", SHA256, "SHA-256 of its bytes."),
            _field("source", KEY, "Who made the mask."),
            _field("source_version", KEY, "Version of the source."),
        ]
    ),
    sorted_by=("camera", "timestamp_ns", "kind"),
)

DEPTH: Final = Table(
    name="depth",
    row="the depth map of one image",
    place="traversals/<traversal_id>/layers/depth/<source>@<version>/depth.parquet",
    schema=pa.schema(
        [
            _field("camera", KEY, "Camera of the picture."),
            _field("timestamp_ns", pa.int64(), "Mid-exposure of the picture: the instant of the map's pose."),
            _field(
                "uri",
                pa.string(),
                "The map's PNG (16 bit grey), relative to the dataset's root: the camera's z is 0.1 m * exp(v ln(1e5) / 65535); 0: unknown.",
            ),
            _field("byte_length", pa.int64(), "Its size."),
            _field("sha256", SHA256, "SHA-256 of its bytes."),
            _field(
                "width_px", pa.int32(), "Width of the map, which is that of a pinhole camera at the picture's place."
            ),
            _field("height_px", pa.int32(), "Height of the map."),
            _field("fx_px", pa.float64(), "Focal length x of the map's pinhole."),
            _field("fy_px", pa.float64(), "Focal length y of the map's pinhole."),
            _field("cx_px", pa.float64(), "Principal point x; the centre of the first pixel is at 0.5."),
            _field("cy_px", pa.float64(), "Principal point y; the centre of the first pixel is at 0.5."),
            _field("source", KEY, "Who made the map."),
            _field("source_version", KEY, "Version of the source."),
        ]
    ),
    sorted_by=("camera", "timestamp_ns"),
)

POINTS: Final = Table(
    name="points",
    row="one point of the static scene, in the layer of the traversal that saw it first",
    place="traversals/<traversal_id>/layers/points/<source>@<version>/points.parquet",
    schema=pa.schema(
        [
            _field("point", pa.int32(), "Counts from 0 within the layer."),
            _field("x_m", pa.float64(), "In the scene's world frame."),
            _field("y_m", pa.float64(), "In the scene's world frame."),
            _field("z_m", pa.float64(), "In the scene's world frame."),
            _field("r", pa.uint8(), "Colour: red, sRGB."),
            _field("g", pa.uint8(), "Colour: green."),
            _field("b", pa.uint8(), "Colour: blue."),
            _field("kind", KEY, "`ground`, `background`, or `far`: outside the block that the source worked on."),
            _field("views", pa.int16(), "Pictures that agree on the point; 0: it was not seen, but extrapolated."),
            _field("sigma_m", pa.float32(), "1-sigma of its position along the ray; null: unknown.", null=True),
            _field("source", KEY, "Who made the point."),
            _field("source_version", KEY, "Version of the source."),
        ]
    ),
    sorted_by=("source", "source_version", "point"),
)

PASSES: Final = Table(
    name="passes",
    row="one pass of a drive through a scene, accepted or refused: the ledger",
    place="drives/<drive_id>/passes.parquet",
    schema=pa.schema(
        [
            _field("scene_id", KEY, "The region of interest."),
            _field("drive_id", KEY, "The drive."),
            _field(
                "traversal_id", pa.string(), "`scene.drive.entry_ms` of an accepted pass; null when refused.", null=True
            ),
            _field("decision", KEY, "`accepted` or `refused`."),
            _field(
                "rule",
                KEY,
                "The rule that refused it: `min_duration`, `min_path` or `min_overlap`; null when accepted.",
                null=True,
            ),
            _field("measured", pa.float64(), "The figure that the rule looked at.", null=True),
            _field("threshold", pa.float64(), "What the rule asked for.", null=True),
            _field("entry_ns", pa.int64(), "Entry, interpolated on the circle."),
            _field("exit_ns", pa.int64(), "Exit, interpolated on the circle."),
            _field("entry_kind", KEY, "`crossing`, `recording_edge`, `gap` or `standstill`."),
            _field("exit_kind", KEY, "`crossing`, `recording_edge`, `gap` or `standstill`."),
            _field("duration_s", pa.float64(), "exit - entry."),
            _field("path_m", pa.float64(), "Length driven between entry and exit."),
            _field("inside_path_m", pa.float64(), "The part of it with r <= R."),
            _field(
                "overlap", pa.float64(), "inside_path_m / path_m; where nothing was driven, the share of time inside."
            ),
            _field("visits", pa.int32(), "How many visits were joined into this pass."),
            _field("split", pa.bool_(), "True if it is one part of a stretch that was split at its longest excursion."),
            _field("poses", pa.int32(), "Cleaned poses between entry and exit."),
            _field("closest_m", pa.float64(), "Smallest distance from the ROI's centre on the way."),
            _field("mean_speed_mps", pa.float64(), "path_m / duration_s."),
            _field(
                "heading_in_deg",
                pa.float64(),
                "Direction of travel at the entry, clockwise from north (local frame: from +y); null: not moving.",
                null=True,
            ),
            _field("heading_out_deg", pa.float64(), "Direction of travel at the exit.", null=True),
            _field("light", KEY, "`day`, `dusk` or `night` at the entry."),
            _field("light_source", KEY, "`solar_elevation`, `metadata` or `unknown`."),
            _field("weather", KEY, "`clear`, `clouds`, `rain`, `snow`, `fog` or `unknown`."),
            _field("weather_source", KEY, "`metadata`, a plug-in's name, or `unknown`."),
        ]
    ),
    sorted_by=("scene_id", "drive_id", "entry_ns"),
)

_KEYS: Final = [
    _field("scene_id", KEY, "The scene."),
    _field("traversal_id", KEY, "The traversal."),
]


def _indexed(table: Table, *extra: pa.Field) -> Table:
    return Table(
        name=table.name,
        row=table.row,
        place=f"index/{table.name}/<scene_id>.parquet",
        schema=pa.schema([*_KEYS, *table.schema, *extra]),
        sorted_by=("traversal_id", *table.sorted_by),
    )


SCENES: Final = Table(
    name="scenes",
    row="one scene: a region of interest and what was recorded in it (GeoParquet)",
    place="index/scenes.parquet",
    schema=pa.schema(
        [
            _field("scene_id", pa.string(), "The scene."),
            _field("city", pa.string(), "As given with the ROI.", null=True),
            _field(
                "scene_type", pa.string(), "`urban`, `highway`, `rural`, `campus`, as given with the ROI.", null=True
            ),
            _field("frame", pa.string(), "Name of the local metric frame; null: WGS 84.", null=True),
            _field("longitude_deg", pa.float64(), "ROI centre, WGS 84.", null=True),
            _field("latitude_deg", pa.float64(), "ROI centre, WGS 84.", null=True),
            _field("x_m", pa.float64(), "ROI centre in its local metric frame.", null=True),
            _field("y_m", pa.float64(), "ROI centre in its local metric frame.", null=True),
            _field("height_m", pa.float64(), "Height of the world's origin above the ellipsoid."),
            _field("radius_m", pa.float64(), "ROI radius."),
            _field("traversals", pa.int32(), "Accepted passes."),
            _field("drives", pa.int32(), "Drives with at least one accepted pass."),
            _field("images", pa.int64(), "Pictures."),
            _field("duration_s", pa.float64(), "Sum over the traversals."),
            _field(
                "geometry",
                pa.binary(),
                "The ROI as WKB polygon (64 vertices a quarter), lon/lat; null in a local frame.",
                null=True,
            ),
            _field("bbox", BBOX, "Bounding box covering of `geometry`.", null=True),
        ]
    ),
    sorted_by=("scene_id",),
)

TRAVERSALS: Final = Table(
    name="traversals",
    row="one accepted pass of a drive through a scene (GeoParquet)",
    place="index/traversals.parquet",
    schema=pa.schema(
        [
            _field("scene_id", pa.string(), "The scene."),
            _field("traversal_id", pa.string(), "`scene.drive.entry_ms`."),
            _field("drive_id", pa.string(), "The drive."),
            _field("vehicle_id", pa.string(), "Pseudonym of the vehicle."),
            _field("vehicle_type", pa.string(), "Make or class of the vehicle."),
            _field("rig_id", pa.string(), "`rigs/<rig_id>.json`; null for a poses-only drive.", null=True),
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
            _field("has_images", pa.bool_(), "False for a poses-only drive."),
            _field("images", pa.int64(), "Pictures."),
            _field("frames", pa.int64(), "Frames of the reference camera."),
            _field("cameras", pa.list_(pa.string()), "Cameras with pictures."),
            _field("layers", pa.list_(pa.string()), "`kind/source@version` of every layer."),
            _field(
                "geometry", pa.binary(), "The driven line as WKB LineString, lon/lat; null in a local frame.", null=True
            ),
            _field("bbox", BBOX, "Bounding box covering of `geometry`.", null=True),
        ]
    ),
    sorted_by=("scene_id", "traversal_id"),
)

FRAMES: Final = Table(
    name="frames",
    row="one instant of the rig: an exposure of the reference camera",
    place="index/frames/<scene_id>.parquet",
    schema=pa.schema(
        [
            *_KEYS,
            _field("frame_index", pa.int32(), "Counts from 0 within the traversal."),
            _field("timestamp_ns", pa.int64(), "Mid-exposure of the reference camera."),
            _field("images", pa.int32(), "Cameras with a picture in this frame."),
            _field("longitude_deg", pa.float64(), "Ego position, WGS 84; null in a local frame.", null=True),
            _field("latitude_deg", pa.float64(), "Ego position, WGS 84; null in a local frame.", null=True),
            _field("x_m", pa.float64(), "Ego position, world x."),
            _field("y_m", pa.float64(), "Ego position, world y."),
        ]
    ),
    sorted_by=("traversal_id", "frame_index"),
)

INDEX_IMAGES: Final = _indexed(
    IMAGES,
    _field("source_sha256", SHA256, "SHA-256 of the bytes as recorded, where a redaction replaced them.", null=True),
    _field("longitude_deg", pa.float64(), "Ego position at mid-exposure, WGS 84; null in a local frame.", null=True),
    _field("latitude_deg", pa.float64(), "Ego position at mid-exposure, WGS 84; null in a local frame.", null=True),
    _field("x_m", pa.float64(), "Ego position at mid-exposure, world x."),
    _field("y_m", pa.float64(), "Ego position at mid-exposure, world y."),
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
    place="index/passes.parquet",
    schema=PASSES.schema,
    sorted_by=PASSES.sorted_by,
)

ROW_GROUPS: Final = Table(
    name="row_groups",
    row="one row group of an index table, that is one traversal's rows, and what a query can skip it by",
    place="index/row_groups.parquet",
    schema=pa.schema(
        [
            _field("table", KEY, "The index table."),
            _field("scene_id", KEY, "Its scene: the file `index/<table>/<scene_id>.parquet`."),
            _field("traversal_id", pa.string(), "The traversal whose rows these are."),
            _field("row_group", pa.int32(), "Position of the row group in the file."),
            _field("rows", pa.int64(), "Number of rows, never 0."),
            _field("start_ns", pa.int64(), "Smallest `timestamp_ns`; null: the table has none.", null=True),
            _field("end_ns", pa.int64(), "Largest `timestamp_ns`.", null=True),
            _field("longitude_min_deg", pa.float64(), "Null: the table or the scene has no such column.", null=True),
            _field("longitude_max_deg", pa.float64(), "Largest longitude.", null=True),
            _field("latitude_min_deg", pa.float64(), "Smallest latitude.", null=True),
            _field("latitude_max_deg", pa.float64(), "Largest latitude.", null=True),
        ]
    ),
    sorted_by=("table", "scene_id", "row_group"),
)

RECORDED: Final[Sequence[Table]] = (EGO_POSES, IMAGES, CALIBRATIONS)
LAYERS: Final[Sequence[Table]] = (BOXES, MASKS, DEPTH, POINTS)
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
