"""Waymo Open Dataset v2, perception: segments of 20 s as Parquet components, with five cameras and boxes.

Facts of the format, from the component definitions that the dataset publishes (v2):

- Each component is a folder with one Parquet file a segment; a segment is the drive ``FOLDER/SEGMENT``.
- The vehicle is x forward, y left, z up, on the ground under the rear axle. Its world frame is east-north-up and
  metric, without a stated place on the globe.
- A camera's frame is x forward, y left, z up; the extrinsic is ``vehicle_SE3_camera``. Distortion is OpenCV's
  k1 k2 p1 p2 k3. The devkit's image spans 0 to the width, so its principal point is taken as it is.
- Shutters roll. The exposure of an image runs from its trigger to the end of its readout; each image has its own pose.
- Boxes have a heading alone, in the vehicle frame of their frame's stamp.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Float64
from mirror.errors import RecordingError
from mirror.geometry.poses import Poses, to_pose_numbers
from mirror.recordings.calibration import Calibration, Stage, make_calibration, to_calibration_table
from mirror.recordings.coordinates import FLU_FROM_CAMERA
from mirror.recordings.opening import find_file, require_file
from mirror.recordings.paths import list_folder, to_identifier
from mirror.recordings.protocol import CameraInfo, DriveInfo, ImageStream, RigInfo, Track
from mirror.recordings.readers.arrow_tables import matrix_of, read_parquet
from mirror.recordings.readers.box_rows import make_box_table, rotation_about_up
from mirror.recordings.readers.collection import choose_drive
from mirror.recordings.readers.stored_poses import REMEDY, is_no_rigid_motion, mark_matrices, require_poses
from mirror.recordings.readers.waymo_images import IMAGE, ParquetStream
from mirror.recordings.registry import refuse_options
from mirror.recordings.row_faults import RowFaults
from mirror.recordings.time import ns_from_seconds
from mirror.recordings.weather import weather_label

_POSES: Final = "vehicle_pose"
_IMAGES: Final = "camera_image"
_CALIBRATIONS: Final = "camera_calibration"
_BOXES: Final = "lidar_box"
_STATS: Final = "stats"
# Of these names, "stats" alone may be that of any folder.
_COMPONENTS: Final = (_POSES, _IMAGES, _CALIBRATIONS, _BOXES, "camera_box", "lidar", "lidar_calibration", "lidar_pose")
_STAMP: Final = "key.frame_timestamp_micros"
_CAMERA: Final = "key.camera_name"
_POSE: Final = "[VehiclePoseComponent].world_from_vehicle.transform"
_SHUTTER: Final = f"{IMAGE}rolling_shutter_params."
_LENS: Final = "[CameraCalibrationComponent]."
_BOX: Final = "[LiDARBoxComponent]."
_STAT: Final = "[StatsComponent]."
_NAMES: Final = {1: "front_wide", 2: "front_left", 3: "front_right", 4: "SIDE_LEFT", 5: "SIDE_RIGHT"}
_SOURCE_NAMES: Final = {1: "FRONT", 2: "FRONT_LEFT", 3: "FRONT_RIGHT", 4: "SIDE_LEFT", 5: "SIDE_RIGHT"}
_TYPES: Final = ("unknown", "vehicle", "pedestrian", "sign", "cyclist")
_DIRECTIONS: Final = {
    1: "top_to_bottom",
    2: "left_to_right",
    3: "bottom_to_top",
    4: "right_to_left",
    5: "global",
}
_LIGHT: Final = {"day": "day", "dawn/dusk": "dusk", "night": "night"}
_CITIES: Final = {"location_sf": "San Francisco", "location_phx": "Phoenix"}
_LAST_US: Final = 9_000_000_000_000_000
_MATRIX: Final = pa.list_(pa.float64(), 16)


def _schema(**kinds: pa.DataType) -> pa.Schema:
    return pa.schema([pa.field(name, kind, nullable=False) for name, kind in kinds.items()])


_POSE_SCHEMA: Final = _schema(**{_STAMP: pa.int64(), _POSE: _MATRIX})
_IMAGE_SCHEMA: Final = _schema(
    **{
        _CAMERA: pa.int64(),
        f"{IMAGE}pose.transform": _MATRIX,
        f"{IMAGE}pose_timestamp": pa.float64(),
        f"{_SHUTTER}shutter": pa.float64(),
        f"{_SHUTTER}camera_trigger_time": pa.float64(),
        f"{_SHUTTER}camera_readout_done_time": pa.float64(),
    }
)
_INTRINSICS: Final = ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")
_LENS_SCHEMA: Final = _schema(
    **{_CAMERA: pa.int64()},
    **{f"{_LENS}intrinsic.{name}": pa.float64() for name in _INTRINSICS},
    **{f"{_LENS}extrinsic.transform": _MATRIX},
    **{f"{_LENS}{name}": pa.int64() for name in ("width", "height", "rolling_shutter_direction")},
)
_CENTRE: Final = tuple(f"{_BOX}box.center.{axis}" for axis in "xyz")
_SIZE: Final = tuple(f"{_BOX}box.size.{axis}" for axis in "xyz")
_BOX_SCHEMA: Final = _schema(
    **{_STAMP: pa.int64(), "key.laser_object_id": pa.string(), f"{_BOX}type": pa.int64()},
    **dict.fromkeys((*_CENTRE, *_SIZE, f"{_BOX}box.heading"), pa.float64()),
)
_STAT_SCHEMA: Final = pa.schema([(f"{_STAT}{name}", pa.string()) for name in ("time_of_day", "location", "weather")])


class WaymoReader:
    """A reader of the segments of a folder of components; each segment is a drive with the path ``FOLDER/SEGMENT``."""

    name = "waymo"
    expects = f"a folder with {_POSES}/*.parquet and any other components of Waymo v2, or FOLDER/SEGMENT"

    def recognises(self, path: Path) -> bool:
        """Return whether the folder holds a component of Waymo v2.

        Without poses, opening it names the missing component.
        """
        return path.is_dir() and bool(_components(path))

    def drives(self, path: Path) -> Sequence[str]:
        """Return the names of the segments that have poses."""
        return _segments(path) if (path / _POSES).is_dir() else []

    def open(self, path: Path, options: Mapping[str, str]) -> WaymoRecording:
        """Open a segment.

        The option ``frame`` names the local frame, for segments that are known to share theirs.
        """
        refuse_options(options, ("frame",), path, self.name)
        found = _components(path) if path.is_dir() else []
        root, name = (path, None) if found else (path.parent, path.name)
        if not (root / _POSES).is_dir() and found:
            raise RecordingError(
                f"a folder of Waymo v2 with {', '.join(found)}, but without the component {_POSES}",
                file=path,
                place=_POSES,
                expected=f"{_POSES}/<segment>.parquet: where the vehicle is",
                remedy=f"download {_POSES} of the same segments into this folder",
            )
        if not (root / _POSES).is_dir():
            raise RecordingError("no segments of Waymo v2", file=path, expected=self.expects)
        segment = choose_drive(_segments(root), name, root)
        frame = options.get("frame")
        return WaymoRecording(root, segment, to_identifier(frame) if frame else None)


def _components(path: Path) -> list[str]:
    """The components of a folder that no other format has under this name, with a file of rows each."""
    return [name for name in _COMPONENTS if next((path / name).glob("*.parquet"), None) is not None]


def _segments(root: Path) -> list[str]:
    files = list_folder(root, root / _POSES)
    return sorted(name.removesuffix(".parquet") for name in files if name.endswith(".parquet"))


@dataclass(frozen=True)
class WaymoRecording:
    """One segment of the Waymo Open Dataset.

    Attributes:
        root: the folder of components.
        segment: the segment's name.
        frame: name of the local frame; None: the segment has a frame of its own.
    """

    root: Path
    segment: str
    frame: str | None = None

    def _find(self, component: str) -> Path | None:
        return find_file(self.root, f"{component}/{self.segment}.parquet")

    def _require(self, component: str) -> Path:
        return require_file(self.root, f"{component}/{self.segment}.parquet")

    @cached_property
    def info(self) -> DriveInfo:
        """The drive; light, weather and city come from the component ``stats`` if that was downloaded."""
        name = to_identifier(f"waymo_{self.segment}")
        file = self._find(_STATS)
        stats: dict[str, str] = {}
        if file is not None:
            rows = read_parquet(file, _STAT_SCHEMA)
            for column in ("time_of_day", "location", "weather"):
                values = rows.column(f"{_STAT}{column}").drop_null()
                stats[column] = str(values[0].as_py()).lower() if len(values) else ""
        return DriveInfo(
            drive_id=name,
            vehicle_id="waymo",
            vehicle_type="unknown",
            time_base="Unix microseconds",
            frame=self.frame or name,
            is_clip=True,
            city=_CITIES.get(stats.get("location", "")),
            weather=weather_label(stats.get("weather")),
            light=_LIGHT.get(stats.get("time_of_day", "")),
            licence="Waymo Dataset License Agreement for Non-Commercial Use",
        )

    @cached_property
    def _rows(self) -> pa.Table | None:
        """The images without their bytes; None: they were not downloaded."""
        file = self._find(_IMAGES)
        return None if file is None else read_parquet(file, _IMAGE_SCHEMA)

    @cached_property
    def _streams(self) -> dict[int, ParquetStream]:
        """Streams by number of the camera."""
        rows, file = self._rows, self._find(_IMAGES)
        if rows is None or file is None:
            return {}
        cameras = np.asarray(rows.column(_CAMERA))
        trigger, done = (
            np.asarray(rows.column(f"{_SHUTTER}{name}")) for name in ("camera_trigger_time", "camera_readout_done_time")
        )
        wrong = ~((np.abs(trigger) < 9e9) & (done >= trigger) & (done < 9e9)) | ~np.isin(cameras, list(_NAMES))
        if wrong.any():
            row = int(np.argmax(wrong))
            raise RecordingError(
                f"camera {cameras[row]} is exposed from {trigger[row]} to {done[row]} s",
                file=file,
                place=f"row {row}",
                expected="a camera from 1 to 5, and a trigger before the end of the readout, in Unix seconds",
                remedy=REMEDY,
            )
        streams = {}
        for number in np.unique(cameras).tolist():
            mine = np.flatnonzero(cameras == number)
            mine = mine[np.argsort(trigger[mine], kind="stable")]
            start, end = ns_from_seconds(trigger[mine]), ns_from_seconds(done[mine])
            streams[number] = ParquetStream(_NAMES[number], start, end, file, mine)
        return streams

    @property
    def rig(self) -> RigInfo | None:
        """The cameras that have images; the front camera is the reference camera."""
        cameras = tuple(CameraInfo(_NAMES[number], _SOURCE_NAMES[number]) for number in self._streams)
        if not cameras:
            return None
        rig_id = "waymo" if len(cameras) == len(_NAMES) else f"waymo_{'_'.join(map(str, self._streams))}"
        return RigInfo(rig_id, cameras, cameras[0].name)

    def files(self) -> Sequence[tuple[str, Path]]:
        """Return the components that are read and exist; lidar is not read."""
        self._require(_POSES)
        components = (_BOXES, _CALIBRATIONS, _IMAGES, _STATS, _POSES)
        return [
            (f"{name}/{self.segment}.parquet", file)
            for name in sorted(components)
            if (file := self._find(name)) is not None
        ]

    def track(self) -> Track:
        """Return the vehicle's poses at the frames and at the images, each at its own stamp."""
        file = self._require(_POSES)
        table = read_parquet(file, _POSE_SCHEMA)
        stamps, matrices = [np.asarray(table.column(_STAMP))], [_matrices(table.column(_POSE))]
        good_stamp = np.abs(stamps[0]) <= _LAST_US
        stamps[0] = np.where(good_stamp, stamps[0], 0) * 1_000
        rows = self._rows
        if rows is not None:
            seconds = np.asarray(rows.column(f"{IMAGE}pose_timestamp"))
            good = np.abs(seconds) < 9e9
            stamps.append(ns_from_seconds(np.where(good, seconds, 0.0)))
            matrices.append(_matrices(rows.column(f"{IMAGE}pose.transform")))
            good_stamp = np.concatenate([good_stamp, good])
        matrix, stamp = np.concatenate(matrices), np.concatenate(stamps)
        poses, bad = mark_matrices(matrix)
        count = table.num_rows

        def error(row: int) -> RecordingError:
            inside = row < count
            return RecordingError(
                f"{matrix[row].tolist()} at {stamp[row]} ns is no pose",
                file=file if inside else self._find(_IMAGES) or file,
                place=f"row {row if inside else row - count}",
                expected="a stamp and a rigid 4x4 matrix",
                remedy=REMEDY,
            )

        faults = RowFaults(len(stamp))
        faults.add(~good_stamp, "time", error)
        faults.add(bad, "rotation", error)
        x, y, z = poses.translation.T
        track = faults.drop_from(Track(stamp, x_m=x, y_m=y, height_m=z, rotation=poses.rotation, file=file))
        order = np.argsort(track.timestamp_ns, kind="stable")
        columns = {name: getattr(track, name)[order] for name in ("timestamp_ns", "x_m", "y_m", "height_m", "rotation")}
        return replace(track, **columns)

    def calibrations(self) -> pa.Table:
        """Return the cameras that have images."""
        calibrations: list[tuple[Stage, Calibration]] = []
        if self._streams:
            file = self._require(_CALIBRATIONS)
            table = read_parquet(file, _LENS_SCHEMA)
            matrices = _matrices(table.column(f"{_LENS}extrinsic.transform"))
            bad = is_no_rigid_motion(matrices)
            for row, values in enumerate(table.drop_columns([f"{_LENS}extrinsic.transform"]).to_pylist()):
                if values[_CAMERA] not in self._streams:
                    continue
                if bad[row]:
                    raise RecordingError(
                        "the extrinsic is no rigid 4x4 matrix", file=file, place=f"row {row}", remedy=REMEDY
                    )
                calibrations.append(("factory", self._calibration(file, values, matrices[row])))
        return to_calibration_table(calibrations, vehicle_id=self.info.vehicle_id, drive_id=self.info.drive_id)

    def _calibration(self, file: Path, values: Mapping[str, Any], matrix: Float64) -> Calibration:
        number = values[_CAMERA]
        lens = [values[f"{_LENS}intrinsic.{name}"] for name in _INTRINSICS]
        mounting = Poses.from_matrix(matrix) @ Poses(FLU_FROM_CAMERA[None], np.zeros((1, 3)))
        direction = _DIRECTIONS.get(values[f"{_LENS}rolling_shutter_direction"], "global")
        rows = self._rows
        readout_ns = 0
        if rows is not None and direction != "global":
            mine = rows.filter(pc.equal(rows.column(_CAMERA), number))
            trigger, done, shutter = matrix_of(
                mine,
                tuple(f"{_SHUTTER}{name}" for name in ("camera_trigger_time", "camera_readout_done_time", "shutter")),
            ).T
            readout_ns = max(0, round(float(np.median(done - trigger - shutter)) * 1e9))
        return make_calibration(
            file,
            _NAMES[number],
            model="brown_conrady",
            width_px=values[f"{_LENS}width"],
            height_px=values[f"{_LENS}height"],
            fx_px=lens[0],
            fy_px=lens[1],
            cx_px=lens[2],
            cy_px=lens[3],
            distortion=tuple(lens[4:]),
            ego_SE3_camera=to_pose_numbers(mounting),
            shutter_direction=direction,
            readout_ns=readout_ns,
            method="Waymo camera_calibration",
        )

    def images(self) -> Mapping[str, ImageStream]:
        """Return the images of each camera, read from the component's file."""
        return {_NAMES[number]: stream for number, stream in self._streams.items()}

    def boxes(self) -> pa.Table | None:
        """Return the boxes of the lidar labels; None if the labels were not downloaded."""
        file = self._find(_BOXES)
        if file is None:
            return None
        table = read_parquet(file, _BOX_SCHEMA)
        if not table.num_rows:
            return None
        stamps, kinds = np.asarray(table.column(_STAMP)), np.asarray(table.column(f"{_BOX}type"))
        heading = np.asarray(table.column(f"{_BOX}box.heading"))
        wrong = (np.abs(stamps) > _LAST_US) | (kinds < 0) | (kinds >= len(_TYPES)) | ~np.isfinite(heading)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise RecordingError(
                f"stamp {stamps[row]}, type {kinds[row]}, heading {heading[row]}",
                file=file,
                place=f"row {row}",
                expected=f"Unix microseconds, a type below {len(_TYPES)} and radians",
                remedy=REMEDY,
            )
        rotation = rotation_about_up(heading)
        ego_SE3_box = require_poses(rotation, matrix_of(table, _CENTRE), file=file, place="row {}".format)
        columns = {
            "timestamp_ns": stamps * 1_000,
            "track_id": table.column("key.laser_object_id"),
            "category": [_TYPES[kind] for kind in kinds.tolist()],
            "source": "waymo",
            "source_version": "v2",
        }
        return make_box_table(ego_SE3_box, matrix_of(table, _SIZE), columns)


def _matrices(column: pa.ChunkedArray) -> Float64:
    """(N, 4, 4) matrices of a column of 16 numbers."""
    parts = [np.asarray(chunk.flatten(), np.float64) for chunk in column.chunks]
    return (np.concatenate(parts) if parts else np.empty(0)).reshape(-1, 4, 4)
