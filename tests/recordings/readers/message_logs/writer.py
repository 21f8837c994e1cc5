"""Writes a known drive as MCAP (ROS 2, Protobuf or JSON messages) and as a rosbag2 database."""

from __future__ import annotations

import base64
import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import cv2
import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import CompressionType, IndexType, Writer
from mcap_protobuf.schema import build_file_descriptor_set
from mcap_ros2._dynamic import serialize_dynamic

from mirror.arrays import Float64, Int64
from mirror.geometry import Poses
from mirror.geometry.geodesy import TangentFrame
from mirror.geometry.quaternions import quaternion_multiply
from mirror.recordings.coordinates import track_from_tangent
from mirror.recordings.protocol import Track
from mirror.recordings.readers.message_logs.ros_definitions import definition_of
from tests.builders.folder import LAT, LON, START_NS

Encoding = Literal["ros2", "protobuf", "json"]
FRAME = TangentFrame(LON, LAT, 500.0)
EGO_SE3_ANTENNA = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.4, 0.1, 1.7]]))
EGO_SE3_IMU = Poses(np.array([[0.9, 0.1, -0.2, 0.3]]), np.array([[0.2, -0.3, 0.5]]))
EGO_SE3_CAMERA = Poses(np.array([[0.5, -0.5, 0.5, -0.5]]), np.array([[1.6, 0.05, 1.5]]))
K = (50.0, 0.0, 31.5, 0.0, 51.0, 23.5, 0.0, 0.0, 1.0)
LENS = (-0.2, 0.05, 0.001, -0.002, 0.01)
TOPICS = """
drive_id = "drive"
vehicle_id = "car_1"
weather = "clear"
[pose]
topic = "/fix"
orientation = "/imu"
[cameras.front_wide]
images = "/front/image/compressed"
info = "/front/camera_info"
"""


@dataclass(frozen=True)
class Drive:
    """A drive in the tangent frame: ``frame_SE3_ego`` at N stamps, images at M stamps."""

    stamps: Int64
    frame_SE3_ego: Poses
    image_stamps: Int64
    images: list[bytes] = field(repr=False)

    def truth(self) -> Track:
        """The ego's track on WGS 84."""
        return track_from_tangent(self.stamps, self.frame_SE3_ego.translation, self.frame_SE3_ego.rotation, FRAME)


def drive(seconds: float = 16.0, *, images: int = 8) -> Drive:
    """Twelve seconds with a bend, uphill."""
    times = np.arange(0.0, seconds, 0.1)
    yaw = 0.3 * np.sin(times / 4.0)
    steps = 8.0 * 0.1 * np.stack([np.cos(yaw), np.sin(yaw), np.full(len(times), 0.01)], axis=1)
    position = np.cumsum(steps, axis=0) - [seconds * 4.0, 0.0, 0.0]
    zeros = np.zeros(len(times))
    rotation = np.stack([np.cos(yaw / 2), zeros, zeros, np.sin(yaw / 2)], axis=1)
    stamps = START_NS + np.round(times * 1e9).astype(np.int64)
    rows = np.linspace(5, len(times) - 5, images).astype(int)
    encoded = []
    for number in range(images):
        pixels = np.full((48, 64, 3), 30 + 20 * number % 200, np.uint8)
        pixels[:, number::9] = 200
        encoded.append(cv2.imencode(".jpg", pixels)[1].tobytes())
    return Drive(stamps, Poses(rotation, position), stamps[rows] + 7_000_000, encoded)


@dataclass(frozen=True)
class Out:
    """One message to write; ``value`` has nested `SimpleNamespace`s with the ROS field names."""

    topic: str
    kind: str
    stamp: int
    value: Any


def messages(one: Drive, *, position: Literal["fix", "odometry", "transforms"] = "fix") -> list[Out]:
    """All messages of a drive, in the order of time; odometry is logged 3 ms after its stamp."""
    out = list(_transforms(START_NS))
    world_SE3_antenna = one.frame_SE3_ego @ EGO_SE3_ANTENNA
    fixes = track_from_tangent(one.stamps, world_SE3_antenna.translation, world_SE3_antenna.rotation, FRAME)
    world_SE3_imu = track_from_tangent(
        one.stamps, one.frame_SE3_ego.translation, (one.frame_SE3_ego @ EGO_SE3_IMU).rotation, FRAME
    )
    for row, stamp in enumerate(one.stamps.tolist()):
        if position == "fix":
            lat, lon, height = (
                float(np.asarray(v)[row]) for v in (fixes.latitude_deg, fixes.longitude_deg, fixes.height_m)
            )
            out.append(Out("/fix", "sensor_msgs/msg/NavSatFix", stamp, _fix(stamp, lat, lon, height)))
            turn = np.asarray(world_SE3_imu.rotation)[row]
            out.append(Out("/imu", "sensor_msgs/msg/Imu", stamp, _imu(stamp, turn)))
        elif position == "odometry":
            pose = one.frame_SE3_ego @ EGO_SE3_IMU
            value = SimpleNamespace(
                header=_header(stamp, "city"),
                child_frame_id="imu_link",
                pose=SimpleNamespace(pose=_pose(pose.rotation[row], pose.translation[row]), covariance=[0.0] * 36),
                twist=SimpleNamespace(
                    twist=SimpleNamespace(linear=_xyz((0, 0, 0)), angular=_xyz((0, 0, 0))), covariance=[0.0] * 36
                ),
            )
            out.append(Out("/odom", "nav_msgs/msg/Odometry", stamp + 3_000_000, value))
        else:
            pose = one.frame_SE3_ego
            out.append(
                Out(
                    "/tf",
                    "tf2_msgs/msg/TFMessage",
                    stamp,
                    _transform(stamp, "map", "base_link", pose.rotation[row], pose.translation[row]),
                )
            )
    for stamp, data in zip(one.image_stamps.tolist(), one.images):
        value = SimpleNamespace(header=_header(stamp, "camera_optical"), format="jpeg", data=data)
        out.append(Out("/front/image/compressed", "sensor_msgs/msg/CompressedImage", stamp, value))
        out.append(Out("/front/camera_info", "sensor_msgs/msg/CameraInfo", stamp, _camera(stamp)))
    return sorted(out, key=lambda message: message.stamp)


def _transforms(stamp: int) -> Iterator[Out]:
    for child, pose in (
        ("gps_antenna", EGO_SE3_ANTENNA),
        ("imu_link", EGO_SE3_IMU),
        ("camera_optical", EGO_SE3_CAMERA),
    ):
        value = _transform(stamp, "base_link", child, pose.rotation[0], pose.translation[0])
        yield Out("/tf_static", "tf2_msgs/msg/TFMessage", stamp, value)


def _transform(stamp: int, parent: str, child: str, rotation: Float64, translation: Float64) -> Any:
    return SimpleNamespace(
        transforms=[
            SimpleNamespace(
                header=_header(stamp, parent),
                child_frame_id=child,
                transform=SimpleNamespace(translation=_xyz(translation), rotation=_turn(rotation)),
            )
        ]
    )


def _header(stamp: int, frame: str) -> Any:
    return SimpleNamespace(stamp=SimpleNamespace(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id=frame)


def _xyz(values: Any) -> Any:
    return SimpleNamespace(x=float(values[0]), y=float(values[1]), z=float(values[2]))


def _turn(q: Float64) -> Any:
    return SimpleNamespace(w=float(q[0]), x=float(q[1]), y=float(q[2]), z=float(q[3]))


def _pose(rotation: Float64, translation: Float64) -> Any:
    return SimpleNamespace(position=_xyz(translation), orientation=_turn(rotation))


def _fix(stamp: int, lat: float, lon: float, height: float) -> Any:
    return SimpleNamespace(
        header=_header(stamp, "gps_antenna"),
        status=SimpleNamespace(status=0, service=1),
        latitude=lat,
        longitude=lon,
        altitude=height,
        position_covariance=[0.04, 0.0, 0.0, 0.0, 0.04, 0.0, 0.0, 0.0, 0.09],
        position_covariance_type=2,
    )


def _imu(stamp: int, turn: Float64) -> Any:
    return SimpleNamespace(
        header=_header(stamp, "imu_link"),
        orientation=_turn(turn),
        orientation_covariance=[0.0] * 9,
        angular_velocity=_xyz((0, 0, 0)),
        angular_velocity_covariance=[0.0] * 9,
        linear_acceleration=_xyz((0, 0, 9.8)),
        linear_acceleration_covariance=[0.0] * 9,
    )


def _camera(stamp: int) -> Any:
    roi = SimpleNamespace(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return SimpleNamespace(
        header=_header(stamp, "camera_optical"), height=48, width=64, distortion_model="plumb_bob", d=list(LENS),
        k=list(K), r=[1.0, 0, 0, 0, 1, 0, 0, 0, 1], p=[0.0] * 12, binning_x=0, binning_y=0, roi=roi,
    )  # fmt: skip


def write_mcap(
    path: Path,
    written: Iterable[Out],
    *,
    encoding: Encoding = "ros2",
    compression: CompressionType = CompressionType.ZSTD,
    chunked: bool = True,
    indexed: bool = True,
    chunk_bytes: int = 4096,
) -> Path:
    """Write messages in the given order."""
    with path.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=chunk_bytes,
            compression=compression,
            use_chunking=chunked,
            index_types=IndexType.ALL if indexed else IndexType.NONE,
            use_statistics=indexed,
            use_summary_offsets=indexed,
            repeat_channels=indexed,
            repeat_schemas=indexed,
        )
        writer.start()
        channels: dict[str, tuple[int, Any]] = {}
        for message in written:
            if message.topic not in channels:
                channels[message.topic] = _register(writer, message, encoding)
            channel, encode = channels[message.topic]
            writer.add_message(channel, message.stamp, encode(message.value), message.stamp)
        writer.finish()
    return path


def _register(writer: Writer, message: Out, encoding: Encoding) -> tuple[int, Any]:
    if encoding == "ros2":
        text = definition_of(message.kind)
        assert text is not None
        schema = writer.register_schema(message.kind, "ros2msg", text.encode())
        return writer.register_channel(message.topic, "cdr", schema), serialize_dynamic(message.kind, text)[
            message.kind
        ]
    name, convert = FOXGLOVE[message.kind]
    if encoding == "json":
        schema = writer.register_schema(name, "jsonschema", b"{}")

        def encode_json(value: Any) -> bytes:
            return json.dumps(convert(value, json_time=True)).encode()

        return writer.register_channel(message.topic, "json", schema), encode_json
    kind = _PROTOBUF[name]
    schema = writer.register_schema(name, "protobuf", build_file_descriptor_set(kind).SerializeToString())

    def encode_protobuf(value: Any) -> bytes:
        filled = kind()
        _fill(filled, convert(value, json_time=False))
        return bytes(filled.SerializeToString())

    return writer.register_channel(message.topic, "protobuf", schema), encode_protobuf


def write_rosbag2(path: Path, written: list[Out], *, definitions: bool) -> Path:
    """A database with the tables of rosbag2, with or without the table of message definitions."""
    with closing(sqlite3.connect(path)) as database:
        database.execute(
            "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT,"
            " offered_qos_profiles TEXT)"
        )
        database.execute(
            "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
        )
        if definitions:
            database.execute(
                "CREATE TABLE message_definitions (id INTEGER PRIMARY KEY, topic_type TEXT, encoding TEXT,"
                " encoded_message_definition TEXT, type_description_hash TEXT)"
            )
        numbers: dict[str, int] = {}
        for message in written:
            text = definition_of(message.kind)
            assert text is not None
            if message.topic not in numbers:
                numbers[message.topic] = len(numbers) + 1
                row = (numbers[message.topic], message.topic, message.kind, "cdr", "")
                database.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?)", row)
                if definitions:
                    database.execute(
                        "INSERT INTO message_definitions VALUES (NULL, ?, 'ros2msg', ?, '')", (message.kind, text)
                    )
            data = serialize_dynamic(message.kind, text)[message.kind](message.value)
            database.execute(
                "INSERT INTO messages VALUES (NULL, ?, ?, ?)", (numbers[message.topic], message.stamp, data)
            )
        database.commit()
    return path


def _time(header: Any, json_time: bool) -> dict[str, int]:
    return {"sec" if json_time else "seconds": header.stamp.sec, "nsec" if json_time else "nanos": header.stamp.nanosec}


def _foxglove_fix(value: Any, json_time: bool) -> dict[str, Any]:
    return {
        "timestamp": _time(value.header, json_time), "frame_id": value.header.frame_id, "latitude": value.latitude,
        "longitude": value.longitude, "altitude": value.altitude, "position_covariance": value.position_covariance,
        "position_covariance_type": value.position_covariance_type,
    }  # fmt: skip


def _foxglove_imu(value: Any, json_time: bool) -> dict[str, Any]:
    # Foxglove has no message of an orientation alone; a pose in a frame is that of the vehicle.
    turn = value.orientation
    ego = quaternion_multiply(np.array([[turn.w, turn.x, turn.y, turn.z]]), EGO_SE3_IMU.inverse().rotation)[0]
    pose = {"position": vars(_xyz((0, 0, 0))), "orientation": vars(_turn(ego))}
    return {"timestamp": _time(value.header, json_time), "frame_id": "enu", "pose": pose}


def _foxglove_image(value: Any, json_time: bool) -> dict[str, Any]:
    data = base64.b64encode(value.data).decode() if json_time else value.data
    stamp = _time(value.header, json_time)
    return {"timestamp": stamp, "frame_id": value.header.frame_id, "data": data, "format": value.format}


def _foxglove_camera(value: Any, json_time: bool) -> dict[str, Any]:
    return {
        "timestamp": _time(value.header, json_time), "frame_id": value.header.frame_id, "width": value.width,
        "height": value.height, "distortion_model": value.distortion_model, "D": value.d, "K": value.k,
    }  # fmt: skip


def _foxglove_transforms(value: Any, json_time: bool) -> dict[str, Any]:
    return {
        "transforms": [
            {
                "timestamp": _time(one.header, json_time), "parent_frame_id": one.header.frame_id,
                "child_frame_id": one.child_frame_id, "translation": vars(one.transform.translation),
                "rotation": vars(one.transform.rotation),
            }
            for one in value.transforms
        ]
    }  # fmt: skip


FOXGLOVE = {
    "sensor_msgs/msg/NavSatFix": ("foxglove.LocationFix", _foxglove_fix),
    "sensor_msgs/msg/Imu": ("foxglove.PoseInFrame", _foxglove_imu),
    "sensor_msgs/msg/CompressedImage": ("foxglove.CompressedImage", _foxglove_image),
    "foxglove_msgs/msg/CompressedVideo": ("foxglove.CompressedVideo", _foxglove_image),
    "sensor_msgs/msg/CameraInfo": ("foxglove.CameraCalibration", _foxglove_camera),
    "tf2_msgs/msg/TFMessage": ("foxglove.FrameTransforms", _foxglove_transforms),
}


def _fill(message: Any, values: dict[str, Any]) -> None:
    for name, value in values.items():
        field_ = getattr(message, name)
        if isinstance(value, dict):
            _fill(field_, value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for one in value:
                _fill(field_.add(), one)
        elif isinstance(value, list):
            field_.extend(value)
        else:
            setattr(message, name, value)


def _protobuf_types() -> dict[str, Any]:
    """Classes of Foxglove's messages, built from their field lists (numbers are of no interest to the reader)."""
    file = descriptor_pb2.FileDescriptorProto(name="foxglove/test.proto", package="foxglove", syntax="proto3")
    F = descriptor_pb2.FieldDescriptorProto
    plain = {
        "double": F.TYPE_DOUBLE,
        "string": F.TYPE_STRING,
        "bytes": F.TYPE_BYTES,
        "int64": F.TYPE_INT64,
        "uint32": F.TYPE_FIXED32,
    }
    layouts = {
        "Time": "int64 seconds, int64 nanos",
        "Vector3": "double x, double y, double z",
        "Quaternion": "double x, double y, double z, double w",
        "Pose": "Vector3 position, Quaternion orientation",
        "LocationFix": "Time timestamp, string frame_id, double latitude, double longitude, double altitude,"
        " double[] position_covariance, int64 position_covariance_type",
        "PoseInFrame": "Time timestamp, string frame_id, Pose pose",
        "CompressedImage": "Time timestamp, string frame_id, bytes data, string format",
        "CompressedVideo": "Time timestamp, string frame_id, bytes data, string format",
        "CameraCalibration": "Time timestamp, string frame_id, uint32 width, uint32 height, string distortion_model,"
        " double[] D, double[] K",
        "FrameTransform": "Time timestamp, string parent_frame_id, string child_frame_id, Vector3 translation,"
        " Quaternion rotation",
        "FrameTransforms": "FrameTransform[] transforms",
    }
    for name, layout in layouts.items():
        message = file.message_type.add(name=name)
        for number, part in enumerate(layout.split(","), 1):
            kind, label = part.split()
            base = kind.removesuffix("[]")
            one = message.field.add(name=label, number=number)
            one.label = F.LABEL_REPEATED if kind.endswith("[]") else F.LABEL_OPTIONAL
            if base in plain:
                one.type = plain[base]
            else:
                one.type, one.type_name = F.TYPE_MESSAGE, f".foxglove.{base}"
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {
        f"foxglove.{name}": message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))
        for name in layouts
    }


_PROTOBUF = _protobuf_types()
