"""The tables of the ground truth."""

from __future__ import annotations

from typing import Final

import pyarrow as pa

from mirror.schema.tables import KEY, Table


def _field(name: str, kind: pa.DataType, doc: str, *, null: bool = False) -> pa.Field:
    return pa.field(name, kind, nullable=null, metadata={"doc": doc})


def _pose_fields(src: str) -> list[pa.Field]:
    return [
        _field("qw", pa.float64(), f"Unit quaternion, scalar part, >= 0, of world_SE3_{src}."),
        *(_field(f"q{axis}", pa.float64(), f"Unit quaternion, {axis}.") for axis in "xyz"),
        *(_field(f"t{axis}_m", pa.float64(), f"Translation {axis}, in the scene's world frame.") for axis in "xyz"),
    ]


POSES: Final = Table(
    name="truth_poses",
    row="the exact pose of the vehicle, or of one of its cameras at one of its pictures",
    place="<recording>/truth/poses.parquet",
    schema=pa.schema(
        [
            _field("body", KEY, "`ego`, or the camera's name."),
            _field("timestamp_ns", pa.int64(), "As recorded: of the pose, or of the picture's mid-exposure."),
            _field("true_ns", pa.int64(), "When that truly was: other than recorded where the camera's clock is off."),
            *_pose_fields("body"),
        ]
    ),
    sorted_by=("body", "timestamp_ns"),
)

BOXES: Final = Table(
    name="truth_boxes",
    row="the exact 3D box of one road user that one picture would show if nothing stood before it",
    place="<recording>/truth/boxes.parquet",
    schema=pa.schema(
        [
            _field("camera", KEY, "Camera of the picture."),
            _field("timestamp_ns", pa.int64(), "The picture's mid-exposure as recorded."),
            _field("track_id", KEY, "The road user, as in boxes.parquet."),
            _field("category", KEY, "Its class."),
            *_pose_fields("box"),
            _field("length_m", pa.float64(), "Extent along the box's x."),
            _field("width_m", pa.float64(), "Extent along the box's y."),
            _field("height_m", pa.float64(), "Extent along the box's z."),
            _field("speed_mps", pa.float64(), "Over ground, along the box's x."),
            _field(
                "visibility",
                pa.float64(),
                "Share seen of the pixels within the picture that would show it if nothing stood before it.",
            ),
            _field("pixels", pa.int64(), "Number of pixels that show it."),
            _field("u_min_px", pa.float64(), "Left edge of the pixels that show it; null: none does.", null=True),
            _field("v_min_px", pa.float64(), "Upper edge.", null=True),
            _field("u_max_px", pa.float64(), "Right edge.", null=True),
            _field("v_max_px", pa.float64(), "Lower edge.", null=True),
        ]
    ),
    sorted_by=("camera", "timestamp_ns", "track_id"),
)
