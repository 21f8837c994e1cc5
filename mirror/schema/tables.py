"""The tables of a dataset: these pyarrow schemas are the specification.

Every field has its documentation in the field metadata; ``python -m mirror.schema.document`` generates
``docs/schema.md`` from it. The metadata is a part of each Parquet file: other words change the bytes and hashes of new
files, so change them only with the schema version. Recorded and layer tables lie in a traversal's folder; the tables of
the index, which are derived from them, are in `mirror.schema.index_tables`.
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


def column(name: str, kind: pa.DataType, doc: str, *, null: bool = False) -> pa.Field:
    """Make a column with its documentation."""
    return pa.field(name, kind, nullable=null, metadata={"doc": doc})


def _pose(src: str, dst: str) -> list[pa.Field]:
    what = f"{dst}_SE3_{src}: maps points of the {src} frame into the {dst} frame"
    return [
        column("qw", pa.float64(), f"Unit quaternion, scalar part, >= 0, of {what}."),
        column("qx", pa.float64(), "Unit quaternion, x."),
        column("qy", pa.float64(), "Unit quaternion, y."),
        column("qz", pa.float64(), "Unit quaternion, z."),
        column("tx_m", pa.float64(), f"Translation x, in the {dst} frame."),
        column("ty_m", pa.float64(), f"Translation y, in the {dst} frame."),
        column("tz_m", pa.float64(), f"Translation z, in the {dst} frame."),
    ]


EGO_POSES: Final = Table(
    name="ego_poses",
    row="one pose of the vehicle, as recorded and cleaned, from 1 s before the entry to 1 s after the exit",
    place="traversals/<traversal_id>/recorded/ego_poses.parquet",
    schema=pa.schema(
        [
            column("timestamp_ns", pa.int64(), "Unix time, UTC."),
            *_pose("ego", "world"),
            column("longitude_deg", pa.float64(), "WGS 84; null in a local metric frame.", null=True),
            column("latitude_deg", pa.float64(), "WGS 84; null in a local metric frame.", null=True),
            column("height_m", pa.float64(), "Above the WGS 84 ellipsoid; null where the source has none.", null=True),
            column("sigma_m", pa.float64(), "Horizontal 1-sigma of the fix, where the source states it.", null=True),
            column(
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
            column("camera", KEY, "Camera name, canonical where the rig maps to it."),
            column("timestamp_ns", pa.int64(), "Mid-exposure, Unix time, UTC: the instant of the image's pose."),
            column("exposure_start_ns", pa.int64(), "Start of the exposure of the first row."),
            column("exposure_end_ns", pa.int64(), "End of the exposure of the last row."),
            column(
                "frame_index",
                pa.int32(),
                "The frame this picture belongs to (its traversal's frames count from 0); null: no frame is within half a period.",
                null=True,
            ),
            column("width_px", pa.int32(), "Width of the stored raster."),
            column("height_px", pa.int32(), "Height of the stored raster."),
            column(
                "uri", pa.string(), "Where the bytes lie: relative to the dataset's root, or absolute through fsspec."
            ),
            column("byte_offset", pa.int64(), "First byte within the uri."),
            column("byte_length", pa.int64(), "Number of bytes; for a video frame, of the whole video."),
            column("codec", KEY, "`jpeg`, `png`, or `video` (then `video_pts` selects the frame)."),
            column("video_pts", pa.int64(), "Presentation time stamp in the video's time base.", null=True),
            column(
                "sha256",
                SHA256,
                "SHA-256 of the bytes; null when hashing was switched off at ingest, or the pictures lie elsewhere.",
                null=True,
            ),
            column("privacy", KEY, "`raw`, or `redacted` where the source delivered pictures already de-identified."),
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
            column("vehicle_id", KEY, "Pseudonym of the vehicle."),
            column("drive_id", KEY, "The drive in which it was valid."),
            column("camera", KEY, "Camera name."),
            column("stage", KEY, "`factory`, `online` or `refined`."),
            column("valid_from_ns", pa.int64(), "First instant of validity; null: from the beginning.", null=True),
            column("valid_to_ns", pa.int64(), "Last instant of validity; null: without end.", null=True),
            column("model", KEY, "`pinhole`, `brown_conrady`, `rational`, `kannala_brandt` or `f_theta`."),
            column("width_px", pa.int32(), "Width of the calibrated raster."),
            column("height_px", pa.int32(), "Height of the calibrated raster."),
            column("fx_px", pa.float64(), "Focal length x (f-theta: 1)."),
            column("fy_px", pa.float64(), "Focal length y (f-theta: 1)."),
            column("cx_px", pa.float64(), "Principal point x; the centre of the first pixel is at 0.5."),
            column("cy_px", pa.float64(), "Principal point y; the centre of the first pixel is at 0.5."),
            column("distortion", pa.list_(pa.float64()), "Coefficients in the order of the model's documentation."),
            *_pose("camera", "ego"),
            column(
                "time_offset_ns",
                pa.int64(),
                "Added to the camera's stamps to give the vehicle's clock; already applied to the images table.",
            ),
            column(
                "shutter_direction",
                KEY,
                "`global`, `top_to_bottom`, `bottom_to_top`, `left_to_right`, `right_to_left`.",
            ),
            column(
                "readout_ns",
                pa.int64(),
                "From the first row's to the last row's start of exposure; 0 for a global shutter.",
            ),
            column(
                "covariance",
                pa.list_(pa.float64()),
                "6x6 row-major, of the mounting: rotation (rad) then translation (m).",
                null=True,
            ),
            column("method", pa.string(), "How it was obtained.", null=True),
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
            column("timestamp_ns", pa.int64(), "Unix time, UTC, of the instant that the box describes."),
            column("track_id", pa.string(), "The object, within the traversal and source."),
            column("category", KEY, "Class in the source's own words, or MIRROR's where it maps."),
            *_pose("box", "ego"),
            column("length_m", pa.float64(), "Extent along the box's x."),
            column("width_m", pa.float64(), "Extent along the box's y."),
            column("height_m", pa.float64(), "Extent along the box's z."),
            column("vx_mps", pa.float64(), "Velocity over ground along the ego frame's x; null: unknown.", null=True),
            column("vy_mps", pa.float64(), "Velocity over ground along the ego frame's y.", null=True),
            column("vz_mps", pa.float64(), "Velocity over ground along the ego frame's z.", null=True),
            column(
                "score",
                pa.float64(),
                "Confidence, 0 to 1; null for a label made by a person or a simulator.",
                null=True,
            ),
            column(
                "attributes",
                ADDED["attributes"],
                "States of the object in the source's own words, such as `vehicle.parked`; null: not stated. Since 1.1.",
                null=True,
            ),
            column("source", KEY, "Who made the box."),
            column("source_version", KEY, "Version of the source."),
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
            column("camera", KEY, "Camera of the masked picture."),
            column("timestamp_ns", pa.int64(), "Mid-exposure of the masked picture."),
            column("kind", KEY, "`dynamic`, `ego`, `sky`, `instance`: what non-zero pixels are."),
            column("uri", pa.string(), "The mask's PNG (8 bit grey), relative to the dataset's root."),
            column("byte_length", pa.int64(), "Its size."),
            column("sha256", SHA256, "SHA-256 of its bytes."),
            column("source", KEY, "Who made the mask."),
            column("source_version", KEY, "Version of the source."),
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
            column("camera", KEY, "Camera of the picture."),
            column("timestamp_ns", pa.int64(), "Mid-exposure of the picture: the instant of the map's pose."),
            column(
                "uri",
                pa.string(),
                "The map's PNG (16 bit grey), relative to the dataset's root: the camera's z is 0.1 m * exp(v ln(1e5) / 65535); 0: unknown.",
            ),
            column("byte_length", pa.int64(), "Its size."),
            column("sha256", SHA256, "SHA-256 of its bytes."),
            column(
                "width_px", pa.int32(), "Width of the map, which is that of a pinhole camera at the picture's place."
            ),
            column("height_px", pa.int32(), "Height of the map."),
            column("fx_px", pa.float64(), "Focal length x of the map's pinhole."),
            column("fy_px", pa.float64(), "Focal length y of the map's pinhole."),
            column("cx_px", pa.float64(), "Principal point x; the centre of the first pixel is at 0.5."),
            column("cy_px", pa.float64(), "Principal point y; the centre of the first pixel is at 0.5."),
            column("source", KEY, "Who made the map."),
            column("source_version", KEY, "Version of the source."),
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
            column("point", pa.int32(), "Counts from 0 within the layer."),
            column("x_m", pa.float64(), "In the scene's world frame."),
            column("y_m", pa.float64(), "In the scene's world frame."),
            column("z_m", pa.float64(), "In the scene's world frame."),
            column("r", pa.uint8(), "Colour: red, sRGB."),
            column("g", pa.uint8(), "Colour: green."),
            column("b", pa.uint8(), "Colour: blue."),
            column("kind", KEY, "`ground`, `background`, or `far`: outside the block that the source worked on."),
            column("views", pa.int16(), "Pictures that agree on the point; 0: it was not seen, but extrapolated."),
            column("sigma_m", pa.float32(), "1-sigma of its position along the ray; null: unknown.", null=True),
            column("source", KEY, "Who made the point."),
            column("source_version", KEY, "Version of the source."),
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
            column("scene_id", KEY, "The region of interest."),
            column("drive_id", KEY, "The drive."),
            column(
                "traversal_id", pa.string(), "`scene.drive.entry_ms` of an accepted pass; null when refused.", null=True
            ),
            column("decision", KEY, "`accepted` or `refused`."),
            column(
                "rule",
                KEY,
                "The rule that refused it: `min_duration`, `min_path` or `min_overlap`; null when accepted.",
                null=True,
            ),
            column("measured", pa.float64(), "The figure that the rule looked at.", null=True),
            column("threshold", pa.float64(), "What the rule asked for.", null=True),
            column("entry_ns", pa.int64(), "Entry, interpolated on the circle."),
            column("exit_ns", pa.int64(), "Exit, interpolated on the circle."),
            column("entry_kind", KEY, "`crossing`, `recording_edge`, `gap` or `standstill`."),
            column("exit_kind", KEY, "`crossing`, `recording_edge`, `gap` or `standstill`."),
            column("duration_s", pa.float64(), "exit - entry."),
            column("path_m", pa.float64(), "Length driven between entry and exit."),
            column("inside_path_m", pa.float64(), "The part of it with r <= R."),
            column(
                "overlap", pa.float64(), "inside_path_m / path_m; where nothing was driven, the share of time inside."
            ),
            column("visits", pa.int32(), "How many visits were joined into this pass."),
            column("split", pa.bool_(), "True if it is one part of a stretch that was split at its longest excursion."),
            column("poses", pa.int32(), "Cleaned poses between entry and exit."),
            column("closest_m", pa.float64(), "Smallest distance from the ROI's centre on the way."),
            column("mean_speed_mps", pa.float64(), "path_m / duration_s."),
            column(
                "heading_in_deg",
                pa.float64(),
                "Direction of travel at the entry, clockwise from north (local frame: from +y); null: not moving.",
                null=True,
            ),
            column("heading_out_deg", pa.float64(), "Direction of travel at the exit.", null=True),
            column("light", KEY, "`day`, `dusk` or `night` at the entry."),
            column("light_source", KEY, "`solar_elevation`, `metadata` or `unknown`."),
            column("weather", KEY, "`clear`, `clouds`, `rain`, `snow`, `fog` or `unknown`."),
            column("weather_source", KEY, "`metadata`, a plug-in's name, or `unknown`."),
        ]
    ),
    sorted_by=("scene_id", "drive_id", "entry_ns"),
)

LIDARS: Final = Table(
    name="lidars",
    row="one sweep of a lidar, whose file stays where it was recorded",
    place="traversals/<traversal_id>/layers/lidars/recorded@1/lidars.parquet",
    schema=pa.schema(
        [
            column("sensor", KEY, "The source's name of the lidar."),
            column("timestamp_ns", pa.int64(), "Unix time, UTC, of the sweep, as its source defines it."),
            column(
                "format",
                KEY,
                "Format of the file: `kitti_velodyne_bin`, `nuscenes_pcd_bin`, `dgp_npz`, `av2_feather`, or another one.",
            ),
            column("uri", pa.string(), "Absolute path or URL of the file, which is no part of the dataset."),
            column("byte_length", pa.int64(), "Its size; null: the file was not opened.", null=True),
            column("sha256", SHA256, "SHA-256 of its bytes; null: the file was not read.", null=True),
            *_pose("sensor", "ego"),
        ]
    ),
    sorted_by=("sensor", "timestamp_ns", "uri"),
)

RECORDED: Final[Sequence[Table]] = (EGO_POSES, IMAGES, CALIBRATIONS)
LAYERS: Final[Sequence[Table]] = (BOXES, MASKS, DEPTH, POINTS)
REFERENCES: Final[Sequence[Table]] = (LIDARS,)
"""Tables of layers that name files outside of the dataset. They never leave it: no list of what leaves has them."""
LAYER_TABLES: Final[Mapping[str, Table]] = {
    "poses": EGO_POSES,
    "calibrations": CALIBRATIONS,
    "boxes": BOXES,
    "masks": MASKS,
    "redaction": IMAGES,
    "depth": DEPTH,
    "points": POINTS,
}
"""The table of each kind of layer that may leave, or whose contents are derived from what may."""
