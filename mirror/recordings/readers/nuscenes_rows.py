"""The columns of the tables of nuScenes that MIRROR reads, and the rows of all scenes or of one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from mirror.arrays import Bool, Float64, Int64

Index: TypeAlias = npt.NDArray[np.int32]


def _columns(**types: pa.DataType) -> pa.Schema:
    return pa.schema([pa.field(name, kind, nullable=False) for name, kind in types.items()])


_TEXT, _INTEGER = pa.string(), pa.int64()
SAMPLE: Final = _columns(token=_TEXT, timestamp=_INTEGER, scene_token=_TEXT)
SAMPLE_DATA: Final = (
    _columns(
        sample_token=_TEXT,
        ego_pose_token=_TEXT,
        calibrated_sensor_token=_TEXT,
        timestamp=_INTEGER,
        filename=_TEXT,
        is_key_frame=pa.bool_(),
    )
    .append(pa.field("width", pa.float64()))
    .append(pa.field("height", pa.float64()))
)
EGO_POSE: Final = _columns(
    token=_TEXT, timestamp=_INTEGER, rotation=pa.list_(pa.float64(), 4), translation=pa.list_(pa.float64(), 3)
)
ANNOTATION: Final = _columns(
    sample_token=_TEXT,
    instance_token=_TEXT,
    translation=pa.list_(pa.float64(), 3),
    rotation=pa.list_(pa.float64(), 4),
    size=pa.list_(pa.float64(), 3),
).append(pa.field("attribute_tokens", pa.list_(pa.string())))
INSTANCE: Final = _columns(token=_TEXT, category_token=_TEXT)


@dataclass(frozen=True)
class Sensor:
    """One sensor as mounted and calibrated in one log.

    Attributes:
        token: its token.
        channel: the sensor's name, such as ``CAM_FRONT``.
        modality: ``camera``, ``lidar`` or ``radar``.
        record: the object of the table ``calibrated_sensor``.
    """

    token: str
    channel: str
    modality: str
    record: Mapping[str, Any]


@dataclass(frozen=True)
class SensorData:
    """The N rows of ``sample_data`` of one scene or all scenes, sorted by scene, sensor and time.

    Attributes:
        timestamp_us: (N,) Unix microseconds.
        sensor: (N,) index into `Tables.sensors`; -1: a dangling token.
        pose: (N,) row of `Tables.poses`; -1: a dangling token.
        key_frame: (N,) whether the row belongs to an annotated frame.
        size_px: (N, 2) width and height of an image.
        filename: (N,) path of the file, relative to the folder.
    """

    timestamp_us: Int64
    sensor: Index
    pose: Index
    key_frame: Bool
    size_px: Index
    filename: pa.Array

    def take(self, rows: Int64 | slice | Bool) -> SensorData:
        """Select some of the rows."""
        positions = np.arange(len(self.timestamp_us))[rows]
        return SensorData(
            self.timestamp_us[rows],
            self.sensor[rows],
            self.pose[rows],
            self.key_frame[rows],
            self.size_px[rows],
            self.filename.take(pa.array(positions)),
        )


@dataclass(frozen=True)
class EgoPoses:
    """The table ``ego_pose``; M rows.

    Attributes:
        timestamp_us: (M,) Unix microseconds.
        rotation: (M, 4) ``map_SE3_ego``, scalar first, as written.
        translation: (M, 3) metres, as written.
    """

    timestamp_us: Int64
    rotation: Float64
    translation: Float64


@dataclass(frozen=True)
class Annotations:
    """The K rows of ``sample_annotation`` of one scene or all scenes, sorted by scene, instance and time.

    Attributes:
        timestamp_us: (K,) stamp of the annotated frame.
        instance: (K,) index into `Tables.instances`; -1: a dangling token.
        rotation: (K, 4) ``map_SE3_box``, scalar first.
        translation: (K, 3) centre in the map's frame, metres.
        size_m: (K, 3) width, length, height.
        attributes: (K,) lists of names; empty where an annotation has none.
    """

    timestamp_us: Int64
    instance: Index
    rotation: Float64
    translation: Float64
    size_m: Float64
    attributes: pa.Array

    def take(self, rows: slice) -> Annotations:
        """Select some of the rows."""
        return Annotations(
            self.timestamp_us[rows],
            self.instance[rows],
            self.rotation[rows],
            self.translation[rows],
            self.size_m[rows],
            self.attributes[rows],
        )
