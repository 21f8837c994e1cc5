"""Decodes messages (ROS 2 CDR, Protobuf, JSON) into MIRROR's own, whatever their encoding and schema family."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64
from mirror.errors import RecordingError
from mirror.installation import install_command
from mirror.recordings.readers.message_logs.container import Message, Topic
from mirror.recordings.readers.message_logs.zstd import plain_message
from mirror.recordings.time import SECOND_NS
from mirror.schema.strict_json import JsonError, decode_json


@dataclass(frozen=True)
class Header:
    """The stamp of a message (0 if it has none), and the frame that the message refers to."""

    stamp_ns: int
    frame: str


@dataclass(frozen=True)
class ImageMessage:
    """One encoded image, or one packet of a video; ``format`` is the message's own word, such as ``jpeg``."""

    header: Header
    format: str
    data: bytes = field(repr=False)


@dataclass(frozen=True)
class CameraMessage:
    """Intrinsics of the published images, after region of interest and binning.

    ``K`` (3, 3) has its pixel centres at whole numbers (OpenCV).
    """

    header: Header
    width_px: int
    height_px: int
    model: str
    distortion: tuple[float, ...]
    K: Float64

    @property
    def is_calibrated(self) -> bool:
        """False if the message states, by a K that begins with 0, that the camera is not calibrated (CameraInfo)."""
        return bool(self.K[0, 0] != 0.0)


@dataclass(frozen=True)
class FixMessage:
    """One satellite fix: degrees, metres above the ellipsoid; ``sigma_m`` is NaN where the receiver states none."""

    header: Header
    valid: bool
    latitude_deg: float
    longitude_deg: float
    height_m: float
    sigma_m: float


@dataclass(frozen=True)
class PoseMessage:
    """``frame_SE3_child``: quaternion (scalar first), then translation; NaN where the message has no such part."""

    header: Header
    child: str
    pose: tuple[float, ...]


@dataclass(frozen=True)
class TransformsMessage:
    """Transforms ``parent_SE3_child`` between frames."""

    transforms: tuple[PoseMessage, ...]


Decoded = ImageMessage | CameraMessage | FixMessage | PoseMessage | TransformsMessage
Kind = str
KINDS: Final[dict[str, Kind]] = {
    "sensor_msgs/CompressedImage": "image",
    "foxglove.CompressedImage": "image",
    "foxglove_msgs/CompressedImage": "image",
    "foxglove.CompressedVideo": "video",
    "foxglove_msgs/CompressedVideo": "video",
    "sensor_msgs/CameraInfo": "camera",
    "foxglove.CameraCalibration": "camera",
    "foxglove_msgs/CameraCalibration": "camera",
    "sensor_msgs/NavSatFix": "fix",
    "foxglove.LocationFix": "fix",
    "foxglove_msgs/LocationFix": "fix",
    "nav_msgs/Odometry": "pose",
    "geometry_msgs/PoseStamped": "pose",
    "geometry_msgs/PoseWithCovarianceStamped": "pose",
    "foxglove.PoseInFrame": "pose",
    "foxglove_msgs/PoseInFrame": "pose",
    "sensor_msgs/Imu": "orientation",
    "tf2_msgs/TFMessage": "transforms",
    "geometry_msgs/TransformStamped": "transforms",
    "foxglove.FrameTransform": "transforms",
    "foxglove.FrameTransforms": "transforms",
    "foxglove_msgs/FrameTransform": "transforms",
    "foxglove_msgs/FrameTransforms": "transforms",
}
"""Kinds of content that the reader makes of message types."""
_REQUIRED: Final = object()
RAW_IMAGES: Final = ("sensor_msgs/Image", "foxglove.RawImage", "foxglove_msgs/RawImage")
"""Types of images without compression, which the reader refuses by name."""


def kind_of(topic: Topic) -> Kind | None:
    """Return the kind of a message type, such as ``image``, ``video``, ``camera``, ``fix`` or ``pose``.

    None: another type.
    """
    return KINDS.get(topic.type.replace("/msg/", "/"))


class MessageDecoder:
    """A decoder of the messages of one log.

    Args:
        path: the log, for messages.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._parsers: dict[str, Callable[[bytes], Any]] = {}

    def decode(self, message: Message) -> Decoded:
        """Decode a message of a type of `KINDS`.

        Raises:
            RecordingError: the encoding or type is unknown, or the message does not follow its definition.
        """
        topic = message.topic
        kind = kind_of(topic)
        if kind is None:
            raise RecordingError(
                f"topic {topic.name} has the type {topic.type or 'without a name'}",
                file=self._path,
                expected=f"one of {', '.join(KINDS)}",
                remedy="convert the topic, or leave it out of the topics file",
            )
        try:
            data = plain_message(message.data, self._path) if topic.encoding == "cdr" else message.data
            return _CONVERT[kind](self._parser(topic)(data))
        except RecordingError:
            raise
        except Exception as error:
            # The parsers of third packages raise errors of any type on damaged bytes.
            raise RecordingError(
                f"a message of {topic.name} cannot be decoded ({type(error).__name__}: {error})",
                file=self._path,
                place=f"logged at {message.log_time_ns} ns",
                expected=f"a message of type {topic.type}",
                remedy="copy the log again, or leave the topic out of the topics file",
            ) from error

    def _parser(self, topic: Topic) -> Callable[[bytes], Any]:
        if topic.name not in self._parsers:
            self._parsers[topic.name] = self._make_parser(topic)
        return self._parsers[topic.name]

    def _make_parser(self, topic: Topic) -> Callable[[bytes], Any]:
        if topic.encoding == "json":
            return _parse_json
        try:
            from mcap.records import Schema
            from mcap_protobuf.decoder import DecoderFactory as Protobuf
            from mcap_ros2.decoder import DecoderFactory as Ros2
        except ImportError as error:
            raise RecordingError(
                "message logs need the packages of the extra mcap", file=self._path, remedy=install_command("mcap")
            ) from error
        schema = Schema(id=1, name=topic.type, encoding=topic.definition_encoding, data=topic.definition)
        parser = Ros2().decoder_for(topic.encoding, schema) or Protobuf().decoder_for(topic.encoding, schema)
        if parser is None:
            raise RecordingError(
                f"topic {topic.name} is encoded as {topic.encoding} with a definition in {topic.definition_encoding!r}",
                file=self._path,
                expected="cdr with ros2msg, protobuf with protobuf, or json",
                remedy="convert the log: for ROS 1, `mcap convert`; for IDL definitions, record with ros2msg",
            )
        return parser


def _parse_json(data: bytes) -> Any:
    try:
        return decode_json(data)
    except JsonError as error:
        raise ValueError(f"{error} at {error.place}") from error


def _get(message: Any, *names: str, default: Any = _REQUIRED) -> Any:
    """A field of a message by the first of its names in the different encodings.

    Raises:
        ValueError: the message has none of them, and there is no default.
    """
    for name in names:
        if isinstance(message, Mapping):
            if name in message:
                return message[name]
        elif hasattr(message, name):
            return getattr(message, name)
    if default is _REQUIRED:
        raise ValueError(f"there is no field {names[0]}")
    return default


def _stamp_ns(time: Any) -> int:
    seconds = int(_get(time, "sec", "seconds"))
    return seconds * SECOND_NS + int(_get(time, "nanosec", "nsec", "nanos"))


def _header(message: Any, frame: str = "frame_id") -> Header:
    inner = _get(message, "header", default=None)
    if inner is None:
        return Header(_stamp_ns(_get(message, "timestamp")), str(_get(message, frame)))
    return Header(_stamp_ns(_get(inner, "stamp")), str(_get(inner, "frame_id")))


def _vector(message: Any, *names: str) -> tuple[float, ...]:
    return tuple(float(_get(message, name)) for name in names)


def _pose(position: Any, orientation: Any) -> tuple[float, ...]:
    return (*_vector(orientation, "w", "x", "y", "z"), *_vector(position, "x", "y", "z"))


def _to_image(message: Any) -> ImageMessage:
    data = _get(message, "data")
    if isinstance(data, str):
        try:
            data = base64.b64decode(data, validate=True)
        except binascii.Error as error:
            raise ValueError(f"data is not base64 ({error})") from error
    return ImageMessage(_header(message), str(_get(message, "format")), bytes(data))


def _to_camera(message: Any) -> CameraMessage:
    """The intrinsics of the published images.

    A message states the size and K of the full sensor. A region of interest is a window of the full sensor, all zero
    for the whole; binning joins pixels of the window, 0 being the same as 1 (REP 104). As `image_geometry` has it, the
    offsets are subtracted from the principal point first; then focal lengths and principal point are divided by the
    binning. The distortion stays.
    """
    K = np.array(list(_get(message, "k", "K")), np.float64)
    if K.shape != (9,):
        raise ValueError(f"K has {K.size} numbers, not 9")
    K = K.reshape(3, 3)
    width, height = int(_get(message, "width")), int(_get(message, "height"))
    roi = _get(message, "roi", default=None)
    if roi is not None:
        x, y, across, down = (int(_get(roi, name)) for name in ("x_offset", "y_offset", "width", "height"))
        if not (x >= 0 and y >= 0 and x + across <= width and y + down <= height):
            raise ValueError(f"the roi {across} x {down} at {x}, {y} leaves the sensor of {width} x {height} px")
        K[:2, 2] -= (x, y)
        width, height = across or width - x, down or height - y
    binning = np.array([max(int(_get(message, name, default=0)), 1) for name in ("binning_x", "binning_y")])
    K[:2] /= binning[:, None]
    return CameraMessage(
        _header(message),
        width // int(binning[0]),
        height // int(binning[1]),
        str(_get(message, "distortion_model")),
        tuple(float(value) for value in _get(message, "d", "D")),
        K,
    )


def _to_fix(message: Any) -> FixMessage:
    # Foxglove's LocationFix has no status.
    status = _get(message, "status", default=None)
    valid = status is None or int(_get(status, "status")) >= 0
    covariance: Sequence[float] = list(_get(message, "position_covariance"))
    known = int(_get(message, "position_covariance_type")) > 0 and len(covariance) == 9
    sigma = float(np.sqrt((covariance[0] + covariance[4]) / 2)) if known else np.nan
    latitude, longitude, height = _vector(message, "latitude", "longitude", "altitude")
    return FixMessage(_header(message), valid, latitude, longitude, height, sigma)


def _to_pose(message: Any) -> PoseMessage:
    pose = _get(message, "pose")
    pose = _get(pose, "pose", default=pose)
    child = str(_get(message, "child_frame_id", default=""))
    return PoseMessage(_header(message), child, _pose(_get(pose, "position"), _get(pose, "orientation")))


def _to_orientation(message: Any) -> PoseMessage:
    header = _header(message)
    turn = _vector(_get(message, "orientation"), "w", "x", "y", "z")
    return PoseMessage(header, header.frame, (*turn, np.nan, np.nan, np.nan))


def _to_transforms(message: Any) -> TransformsMessage:
    parts = list(_get(message, "transforms", default=[message]))
    return TransformsMessage(tuple(_to_transform(part) for part in parts))


def _to_transform(message: Any) -> PoseMessage:
    transform = _get(message, "transform", default=message)
    pose = _pose(_get(transform, "translation"), _get(transform, "rotation"))
    return PoseMessage(_header(message, "parent_frame_id"), str(_get(message, "child_frame_id")), pose)


_CONVERT: Final[dict[Kind, Callable[[Any], Decoded]]] = {
    "image": _to_image,
    "video": _to_image,
    "camera": _to_camera,
    "fix": _to_fix,
    "pose": _to_pose,
    "orientation": _to_orientation,
    "transforms": _to_transforms,
}
